"""Guards: cheap bounds on the distance of geoms whose contact an engine does not compute.

`pairs` lists the geom pairs that MuJoCo can collide, `bounds` computes lower bounds on their distances for a chunk of
worlds. Where no bound is crossed, MuJoCo finds no contact either, so that an engine without these contacts is exact.
"""

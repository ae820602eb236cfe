"""Constraints of the lanes engine: contacts, limits, dry friction, equality, and the Newton solver on them.

`contacts` finds contacts with planes, `body_contacts` those between bodies, `dof_constraints` limits and friction of
joints, `path_rows` those of tendons and equality of joints, `closures` equality of bodies; `cones` has the forces of a
contact and `solver` minimises MuJoCo's cost over the accelerations, with `coupled` where constraints join branches of
the tree.
"""

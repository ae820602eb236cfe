"""Several sets of recordings of one robot, each beside what the one before it says.

`carried` is what a set says of the robot for the next one, `changes` compares sets, `combined` adds the numbers of
effects that apply one after another.
"""

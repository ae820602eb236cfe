"""LeRobot datasets: episodes of a follower arm in numbers whose unit, sign and zero no file states.

`frames` reads names and numbers, `joints` says which joint of a model each number belongs to, `scales` (with the steps
of encoders in `steps`) what it is worth, and `loading` makes recordings of them.
"""

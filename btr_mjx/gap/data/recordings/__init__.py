"""Recordings: columns of a model become times, states and commands without holes.

`recording` builds a `Recording`: `clocks` brings tables together, `rows` drops and splits, `held` and `wraps` see
repeated rows and jumps by a turn, `velocities` and `unmeasured` estimate what no sensor measured. `noise` is that of
the sensors, `splits` says what is held out, and `stretches` takes parts of long files.
"""

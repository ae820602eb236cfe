"""The base of a robot whose pose nobody measured: an inertial unit and feet that touch the ground tell its motion.

`estimate_bases` fills in states of recordings. `smoother` estimates the motion, from residuals (`residuals`) of
`touching` points and of the unit, put together in a `block_system`.
"""

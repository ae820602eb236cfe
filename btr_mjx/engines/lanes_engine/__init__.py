"""The lanes engine: one array per physical scalar, the batch along its last axis.

`LanesStepper` computes MuJoCo's equations for a chunk of worlds at once. Every physical scalar is an array of its own
whose last axis is the batch, so that plain elementwise code fills the SIMD lanes of a CPU; the kinematic tree's
sparsity is used, and the program is unrolled while JAX traces it.
"""

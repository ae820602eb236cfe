"""Physics engines that step chunks of pairs: `lanes` (fast), `mjx` (general, any device), `native` (the reference).

`Stepper` is the interface of engines inside JAX, `Program` the compiled rollout around it; `native.rollout_native` runs
MuJoCo's C code on threads. All agree with native MuJoCo to the tolerance of their precision.

Names load on first use (`__init__.pyi` lists them): native MuJoCo does not load JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

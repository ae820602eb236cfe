"""The lanes engine for any MuJoCo model: rollouts of many states under given controls, without a `Robot`.

    rolled = lanes.rollout(model, initial_states, controls)     # as mujoco.rollout
    print(lanes.coverage(model))                                # what is computed, guarded and refused

Names load on first use (`__init__.pyi` lists them).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Domain randomisation from identified parameters: reads randomisation.json, the output of a run of btr_mjx.

    from randomize import randomizer

    randomize = randomizer("runs/robot/randomisation.json")
    batched, in_axes = randomize(mjx_model, jax.random.split(key, 4096))       # models of 4096 worlds
    step = jax.vmap(mjx.step, in_axes=(in_axes, 0))                            # step(batched, data)

In MuJoCo Playground, `randomize` is the environment's `randomization_fn`:

    train(..., randomization_fn=randomize)       # or functools.partial(randomize, rng=keys) where it asks for one
                                                 # argument

Each parameter is drawn uniformly from its interval, on its own; the numbers of the model that belong to one parameter
(a mass and its inertia) move together. The model must be the one that the file was made for: the mended MJCF, or the
robot at its identified parameters.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from mujoco import mjx


def randomizer(file: str | Path) -> Callable[[mjx.Model, jax.Array], tuple[mjx.Model, Any]]:
    """A function (model, rng) -> (model with a leading axis in the fields that vary, in_axes for `jax.vmap`).

    Args:
      file: randomisation.json; its "parameters" are parameter -> path -> [value at its low end, value at its high end].

    Returns:
      The function. Its `rng` holds one key for each world.
    """
    parameters = list(json.loads(Path(file).read_text(encoding="utf-8"))["parameters"].values())

    def randomize(model: mjx.Model, rng: jax.Array) -> tuple[mjx.Model, Any]:
        def has(name: str) -> bool:
            return hasattr(model.opt if name.startswith("opt.") else model, name.removeprefix("opt."))

        # Fields that MJX does not hold, such as constants of MuJoCo's C engine, are left out.
        moved = [
            [(*_place(path), *ends) for path, ends in paths.items() if has(_place(path)[0])] for paths in parameters
        ]
        own = {name: _read(model, name) for numbers in moved for name, *_ in numbers}

        def draw(key: jax.Array) -> dict[str, jax.Array]:
            values = dict(own)
            for share, numbers in zip(jax.random.uniform(key, (len(moved),)), moved, strict=True):
                for name, index, low, high in numbers:
                    # Differences from the model's own value add up where two parameters move one number.
                    change = low + share * (high - low) - own[name][index]
                    values[name] = values[name].at[index].add(change)
            return values

        in_axes = jax.tree.map(lambda _: None, model).tree_replace(dict.fromkeys(own, 0))
        return model.tree_replace(jax.vmap(draw)(rng)), in_axes

    return randomize


def _place(path: str) -> tuple[str, tuple[int, ...]]:
    """Field of an mjx.Model and index of the number that a path of randomisation.json names."""
    name = re.sub(r"\[\d+\]", "", path).replace("option/", "opt.")
    return name, tuple(int(number) for number in re.findall(r"\[(\d+)\]", path))


def _read(model: mjx.Model, name: str) -> jax.Array:
    owner, _, field = name.rpartition(".")
    return jnp.asarray(getattr(getattr(model, owner) if owner else model, field))

import numpy as np
from gap_arm import dataset
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.gap.experiments import random_commands

MADE = dataset(fit=1, test=1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_commands_stay_within_recorded_range_and_rate(seed: int) -> None:
    recorded = np.stack([own.ctrl for own in MADE.recordings])
    low, high = recorded.min(1), recorded.max(1)
    lowest, highest = (low - 0.5 * (high - low)).min(0), (high + 0.5 * (high - low)).max(0)
    rate = np.abs(np.diff(recorded, axis=1) / np.diff(MADE.recordings[0].time)[:, None]).max((0, 1))
    for command in random_commands(MADE, np.random.default_rng(seed), 3):
        assert command.values.shape == (len(command.times), MADE.model.nu)
        assert (command.values >= lowest - 1e-9).all()
        assert (command.values <= highest + 1e-9).all()
        fastest = np.abs(np.diff(command.values, axis=0) / np.diff(command.times)[:, None]).max(0)
        assert (fastest <= 2.0 * rate * (1 + 1e-6)).all()


def test_commands_are_drawn_from_the_seed_and_differ() -> None:
    first, again = (random_commands(MADE, np.random.default_rng(3), 4) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.values, b.values)
    assert len({own.values.tobytes() for own in first}) == 4

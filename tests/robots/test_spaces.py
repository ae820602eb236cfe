"""Boxes and their bit-string code, against plain Python integers."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.robots import Box
from btr_mjx.robots.bit_codes import bits_to_index, index_to_bits

# Reproducible examples, and no time limits on a busy machine.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")

LIMBS = Box([f"bl_{i}" for i in range(3, 15)], 0.4, 1.6, units="m")


@st.composite
def boxes(draw, max_n=4):
    n = draw(st.integers(1, max_n))
    low = draw(st.lists(st.floats(-100, 100), min_size=n, max_size=n))
    span = draw(st.lists(st.floats(1e-3, 100), min_size=n, max_size=n))
    bits = draw(st.lists(st.integers(1, 20), min_size=n, max_size=n))
    code = draw(st.sampled_from(["binary", "gray"]))
    return Box([f"p{i}" for i in range(n)], low, np.add(low, span), bits=bits, code=code)


def plain_decode(box, genome):
    """One parameter and one bit at a time, with Python's integers."""
    values, at = [], 0
    for low, high, bits in zip(box.low, box.high, box.bits, strict=True):
        index = previous = 0
        for bit in genome[at : at + bits]:
            previous = int(bit) ^ previous if box.code == "gray" else int(bit)
            index = 2 * index + previous
        values.append(low + (high - low) * (index / (2**bits - 1)))
        at += bits
    return values


@given(boxes(), st.integers(0, 2**32))
def test_decode_matches_plain_loop_and_encode_inverts_it(box, seed):
    genomes = box.random_genomes(np.random.default_rng(seed), (2, 3))
    values = box.decode(genomes)
    assert values.shape == (2, 3, box.n)
    assert values.dtype == np.float64
    expected = [[plain_decode(box, g) for g in row] for row in genomes]
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(box.encode(values), genomes)


@given(boxes(), st.integers(0, 2**32))
def test_encode_takes_the_nearest_grid_point(box, seed):
    values = box.sample(np.random.default_rng(seed), 5)
    error = np.abs(box.decode(box.encode(values)) - values)
    assert (error <= box.step * (0.5 + 1e-6)).all()


@given(boxes())
def test_bounds_decode_exactly(box):
    for bound in (box.low, box.high):
        np.testing.assert_array_equal(box.decode(box.encode(bound)), bound)


@given(st.integers(1, 32), st.sampled_from(["binary", "gray"]), st.data())
def test_codes_round_trip(n_bits, code, data):
    index = np.array(data.draw(st.lists(st.integers(0, 2**n_bits - 1), min_size=1, max_size=8)))
    bits = index_to_bits(index, n_bits, code)
    assert bits.shape == (len(index), n_bits)
    np.testing.assert_array_equal(bits_to_index(bits, code), index)


def test_gray_neighbours_differ_in_one_bit_and_binary_is_pythons():
    index = np.arange(256)
    gray = index_to_bits(index, 8, "gray")
    assert ((gray[1:] ^ gray[:-1]).sum(1) == 1).all()
    binary = index_to_bits(index, 8, "binary")
    assert ["".join(map(str, row)) for row in binary.astype(int)] == [f"{i:08b}" for i in index]


def test_sizes_and_draws():
    assert (LIMBS.n, LIMBS.n_bits) == (12, 96)
    rng = np.random.default_rng(0)
    assert LIMBS.sample(rng).shape == (12,)
    assert LIMBS.random_genomes(rng, 3).shape == (3, 96)
    values = LIMBS.sample(rng, 4000)
    assert values.min() >= 0.4
    assert values.max() <= 1.6
    np.testing.assert_allclose(values.mean(0), 1.0, atol=0.03)
    np.testing.assert_allclose(LIMBS.random_genomes(rng, 4000).mean(0), 0.5, atol=0.05)
    np.testing.assert_allclose(LIMBS.decode(LIMBS.random_genomes(rng, 4000)).mean(0), 1.0, atol=0.03)


def test_draws_depend_on_the_seed_alone():
    a, b = (LIMBS.sample(np.random.default_rng(3), 2) for _ in range(2))
    np.testing.assert_array_equal(a, b)


def test_value_semantics():
    same = Box([f"bl_{i}" for i in range(3, 15)], [0.4] * 12, [1.6] * 12, units=["m"] * 12)
    assert same == LIMBS
    assert hash(same) == hash(LIMBS)
    assert len({same, LIMBS}) == 1
    assert same != LIMBS.with_bits(9)
    assert same != dataclasses.replace(same, code="binary")
    assert same != "a box"
    with pytest.raises(dataclasses.FrozenInstanceError):
        LIMBS.low = np.zeros(12)
    with pytest.raises(ValueError, match="read-only"):
        LIMBS.low[0] = 0.0
    low = np.zeros(2)
    box = Box(["a", "b"], low, 1.0)
    low[0] = 0.5
    assert box.low[0] == 0.0


def test_index_names_the_valid_ones():
    assert LIMBS.index("bl_5") == 2
    np.testing.assert_array_equal(LIMBS.indices(["bl_14", "bl_3"]), [11, 0])
    with pytest.raises(ValueError, match=r"unknown parameter 'bl14'; did you mean 'bl_14'\? \(valid: bl_3, bl_4, "):
        LIMBS.index("bl14")
    with pytest.raises(ValueError, match=r"unknown parameter 'zzz' \(valid: bl_3"):
        LIMBS.index("zzz")


def test_validate_accepts_and_copies():
    values = np.full((2, 3, 12), 1.0)
    checked = LIMBS.validate(values)
    assert checked.shape == values.shape
    checked[:] = 0
    assert (values == 1).all()
    assert LIMBS.validate(np.ones((0, 12))).shape == (0, 12)


def test_validate_forgives_float32_bounds():
    bounds = np.array([[0.4] * 12, [1.6] * 12], dtype=np.float32)
    assert float(bounds[1, 0]) > 1.6
    np.testing.assert_array_equal(LIMBS.validate(bounds)[1], LIMBS.high)


@pytest.mark.parametrize(
    ("row", "value", "message"),
    [
        (1, 1.7, r"lengths: got 1.7 for 'bl_5' in row 1, expected a value within \[0.4, 1.6\] m; correct"),
        (0, np.nan, r"lengths: got nan for 'bl_5' in row 0, .*NaN"),
        (2, -np.inf, r"lengths: got -inf for 'bl_5' in row 2"),
        (2, 1.6001, r"lengths: got 1.6001"),
    ],
)
def test_validate_names_the_culprit(row, value, message):
    values = np.ones((3, 12))
    values[row, 2] = value
    with pytest.raises(ValueError, match=message):
        LIMBS.validate(values, "lengths")


def test_validate_other_shapes():
    with pytest.raises(ValueError, match=r"got 2.0 for 'bl_3', expected .* \(12 such values\)"):
        LIMBS.validate(np.full(12, 2.0))
    with pytest.raises(ValueError, match=r"in row \(1, 0\)"):
        LIMBS.validate(np.array([[[1.0] * 12], [[3.0] * 12]]))
    with pytest.raises(ValueError, match=r"got shape \(11,\), expected \(\.\.\., 12\)"):
        LIMBS.validate(np.ones(11))
    with pytest.raises(ValueError, match=r"got shape \(\)"):
        LIMBS.validate(1.0)
    with pytest.raises(ValueError, match="expected an array of real numbers"):
        LIMBS.validate(["one"] * 12)


def test_genomes_are_checked():
    with pytest.raises(ValueError, match=r"got shape \(95,\), expected \(\.\.\., 96\)"):
        LIMBS.decode(np.zeros(95, bool))
    with pytest.raises(ValueError, match="entries other than 0 and 1"):
        LIMBS.decode(np.full(96, 2))
    np.testing.assert_array_equal(LIMBS.decode(np.zeros(96, int)), LIMBS.low)


def test_clip():
    np.testing.assert_array_equal(LIMBS.clip(np.linspace(0, 2, 12))[[0, -1]], [0.4, 1.6])
    assert np.isnan(LIMBS.clip(np.full(12, np.nan))).all()


def test_subspace_and_embed():
    box = Box(["a", "b", "c"], [0, 1, 2], [10, 11, 12], bits=[3, 4, 5], code="binary", units=["m", "", "rad"])
    inner = box.subspace(["c", "a"])
    assert inner == Box(["c", "a"], [2, 0], [12, 10], bits=[5, 3], code="binary", units=["rad", "m"])
    base = np.array([5.0, 6.0, 7.0])
    full = box.embed(base, ["c", "a"], [[8.0, 1.0], [9.0, 2.0]])
    np.testing.assert_array_equal(full, [[1, 6, 8], [2, 6, 9]])
    np.testing.assert_array_equal(base, [5, 6, 7])
    np.testing.assert_array_equal(box.embed([base, base], ["b"], [2.0]), [[5, 2, 7], [5, 2, 7]])
    with pytest.raises(ValueError, match="unknown parameter 'd'"):
        box.embed(base, ["d"], [1.0])
    with pytest.raises(ValueError, match=r"got 13\.0 for 'c'"):
        box.embed(base, ["c"], [13.0])
    with pytest.raises(ValueError, match=r"base: got 50\.0 for 'a'"):
        box.embed([50.0, 6.0, 7.0], ["c"], [3.0])
    with pytest.raises(ValueError, match="a more than once"):
        box.subspace(["a", "a"])
    with pytest.raises(ValueError, match="single string 'a'"):
        box.subspace("a")


@given(boxes(), st.data())
def test_embed_keeps_the_rest(box, data):
    names = data.draw(st.lists(st.sampled_from(box.names), unique=True, min_size=1))
    rng = np.random.default_rng(0)
    base, values = box.sample(rng), box.subspace(names).sample(rng, 3)
    full = box.embed(base, names, values)
    for i, name in enumerate(box.names):
        expected = values[:, names.index(name)] if name in names else np.full(3, base[i])
        np.testing.assert_array_equal(full[:, i], expected)


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((["a", "a"], 0, 1), {}, "a more than once"),
        ((["a", ""], 0, 1), {}, "non-empty"),
        (([], 0, 1), {}, "one or more"),
        (("ab", 0, 1), {}, "single string"),
        ((["a", "b"], [0, 0, 0], 1), {}, r"Box low: got shape \(3,\), expected \(2,\)"),
        ((["a"], 1, 1), {}, r"Box bounds of 'a': got \[1.0, 1.0\], expected finite low < high"),
        ((["a"], 0, np.nan), {}, "expected finite low < high"),
        ((["a"], 0, np.inf), {}, "expected finite low < high"),
        ((["a"], 0, 1), {"bits": 0}, r"Box bits of 'a': got 0, expected 1 \.\. 32"),
        ((["a"], 0, 1), {"bits": 33}, "got 33"),
        ((["a"], 0, 1), {"bits": 8.5}, "Box bits: got"),
        ((["a", "b"], 0, 1), {"bits": [8]}, "expected one value for all or 2"),
        ((["a", "b"], 0, 1), {"units": ["m"]}, "expected one value for all or 2"),
        ((["a"], 0, 1), {"code": "grey"}, "got 'grey', expected one of 'binary', 'gray'"),
        ((["a"], 1e9, 1e9 + 1e-5), {"bits": 16}, "finer than float64 resolves"),
    ],
)
def test_constructor_errors(arguments, keywords, message):
    with pytest.raises(ValueError, match=message):
        Box(*arguments, **keywords)

"""Figures of a diagnosis: each function makes one matplotlib Figure from saved data and reads no file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from btr_mjx.gap.results import JointForce, effect_at_place

MEASURED, BEFORE, AFTER = "#000000", "#c8641e", "#1f5fa8"
"""Colours of data, believed model and mended model; dots, dashes and a solid line distinguish them in grey as well."""

_CHANNELS = 5
"""Channels of a command that are drawn, at most."""


def force_data(arrays: Mapping[str, np.ndarray]) -> list[JointForce]:
    """Missing forces at joints, of joint_forces.npz."""
    keys = ("position", "velocity", "load", "time", "before", "after", "law", "spread")
    texts = zip(*([str(text) for text in arrays[key]] for key in ("joints", "units", "follows")), strict=True)
    return [
        JointForce(joint, unit, **{key: arrays[f"{key}_{n}"] for key in keys}, follows=tuple(follows.split()))
        for n, (joint, unit, follows) in enumerate(texts)
    ]


def force_figure(joints: Sequence[JointForce], mended: bool = True) -> Figure:
    """Missing force against position, velocity and load, or against what a law depends on; one row a joint."""
    figure = Figure(figsize=(7.4, 0.6 + 2.0 * len(joints)))
    axes = figure.subplots(len(joints), 3, squeeze=False, sharey="row")
    for row, one in zip(axes, joints, strict=True):
        others = [name for name in ("position", "velocity", "load") if name not in one.follows]
        length = "rad" if one.unit == "N m" else "m"
        units = {"position": length, "velocity": f"{length}/s", "load": one.unit, "time": "s"}
        for panel, name in zip(row, [*one.follows, *others], strict=False):
            x = getattr(one, name)
            panel.plot(x, one.before, ".", color="0.55", markersize=1.6, label="missing")
            if mended:
                panel.plot(x, one.after, ".", color=AFTER, markersize=1.2, label="left")
            if one.law.any() and name in one.follows:
                at = np.argsort(x)
                alone = len(one.follows) == 1
                look: dict[str, Any] = {"color": BEFORE, "label": "law"}
                if alone:
                    low, high = (one.law + sign * one.spread for sign in (-1, 1))
                    panel.fill_between(x[at], low[at], high[at], color=BEFORE, alpha=0.3, linewidth=0)
                    panel.plot(x[at], one.law[at], linewidth=1.3, **look)
                else:
                    panel.plot(x, one.law, ".", markersize=1.6, **look)
            panel.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
            panel.set_xlabel(f"{name} [{units[name]}]")
            panel.xaxis.set_major_locator(MaxNLocator(4))
        every = np.concatenate([one.before, one.after])
        reach = 1.15 * float(np.quantile(np.abs(every), 0.995)) + 1e-12
        row[0].set_ylim(-reach, reach)
        row[0].set_ylabel(f"force [{one.unit}]")
        row[0].set_title(one.joint, loc="left", fontsize=8)
    handles, labels = next((h, t) for h, t in (a.get_legend_handles_labels() for a in axes.ravel()) if h)
    figure.legend(handles, labels, loc="outside upper left", ncols=3, markerscale=4)
    return figure


def numbers_over_sets(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Numbers over sets of recordings, a panel each, from the rows of sets.csv."""
    keys = list(dict.fromkeys((r["effect"], r["location"], r["parameter"]) for r in rows))
    figure = Figure(figsize=(7.2, 0.5 + 1.5 * len(keys)))
    axes = figure.subplots(len(keys), 1, squeeze=False)[:, 0]
    for panel, key in zip(axes, keys, strict=True):
        own = [r for r in rows if (r["effect"], r["location"], r["parameter"]) == key]
        at = np.array([r["set"] for r in own])
        value, low, high = (np.array([r[name] for r in own], float) for name in ("value", "low", "high"))
        panel.errorbar(at, value, [value - low, high - value], color="black", marker="o", capsize=3, linewidth=1.1)
        panel.set_title(effect_at_place(own[0]), loc="left", fontsize=8)
        panel.set_ylabel(f"{key[2]} [{own[0]['unit']}]")
        panel.set_xticks(at, [str(r["name"]) for r in own])
    return figure


def commands(time: np.ndarray, values: np.ndarray, names: Sequence[str]) -> Figure:
    """A proposed command (K, n) over times (K,) [s]: the channels with the largest range."""
    chosen = np.argsort(-np.ptp(values, axis=0), kind="stable")[:_CHANNELS]
    figure = Figure(figsize=(7.2, 2.2))
    axes = figure.subplots()
    for k, style in zip(chosen, ("-", "--", ":", "-.", (0, (6, 2, 1, 2, 1, 2))), strict=False):
        axes.plot(time, values[:, k], linestyle=style, linewidth=1.1, label=names[k])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("command\n[own unit]")
    figure.legend(loc="outside upper left", ncols=5)
    return figure

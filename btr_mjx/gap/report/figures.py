"""Figures of a diagnosis: each function makes one matplotlib Figure from saved data and reads no file."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from btr_mjx.gap.results import JointForce, effect_at_place, format_number

MEASURED, BEFORE, AFTER = "#000000", "#c8641e", "#1f5fa8"
"""Colours of data, believed model and mended model; dots, dashes and a solid line distinguish them in grey as well."""

_WIDEST = 46
"""Characters in a line of a candidate's name."""

_CANDIDATES, _CHANNELS = 14, 5
"""Largest numbers of candidates of a ranking, and of channels of a command."""


def disagreement_map(
    rows: Sequence[str], columns: Sequence[str], before: np.ndarray, after: np.ndarray | None = None
) -> Figure:
    """Heat map of the disagreement by part and regime, in units of the noise.

    Args:
      rows: names of joints or bodies.
      columns: names of regimes.
      before: (R, C) disagreement of the believed model, 1 is the noise; NaN where there are no data.
      after: (R, C) the same of the mended model, or None.

    Returns:
      The figure, one panel a model.
    """
    panels = [("believed model", before)] + ([("mended model", after)] if after is not None else [])
    height = 1.3 + 0.21 * len(rows)
    figure = Figure(figsize=(2.2 + len(panels) * max(2.2, 0.55 * len(columns)), height))
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    known = before[np.isfinite(before)]
    top = max(4.0, float(known.max(initial=1.0)))
    grey = matplotlib.colormaps["Greys"].with_extremes(bad="#ffffff")
    norm = LogNorm(1.0, top, clip=True)
    image = None
    for panel, (name, values) in zip(axes, panels, strict=True):
        shown = np.ma.masked_invalid(np.asarray(values, float))
        image = panel.imshow(shown, cmap=grey, norm=norm, aspect="auto")
        for i in range(len(rows)):
            for j in range(len(columns)):
                value = float(np.asarray(values, float)[i, j])
                dark = np.isfinite(value) and norm(value) > 0.55
                text = format_number(value, 2) if np.isfinite(value) else "·"
                panel.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
        panel.set_title(name)
        panel.set_xticks(range(len(columns)), columns, rotation=40, ha="right")
        panel.tick_params(length=0)
        for spine in panel.spines.values():
            spine.set_visible(False)
    axes[0].set_yticks(range(len(rows)), rows)
    assert image is not None
    bar = figure.colorbar(image, ax=list(axes), shrink=min(1.0, 2.0 / height), pad=0.02)
    marks = [m * 10**e for e in range(int(np.log10(top)) + 1) for m in (1, 2, 5) if m * 10**e <= top]
    bar.set_ticks(marks[-6:], labels=[f"{mark:g}" for mark in marks[-6:]])
    bar.minorticks_off()
    bar.set_label("force² / noise")
    return figure


def ranking_bars(
    rows: Sequence[Mapping[str, Any]],
    found: Sequence[tuple[str, str]],
    threshold: float | None = None,
) -> Figure:
    """Candidates by score: named effects black, equivalent candidates hatched, the others grey.

    Args:
      rows: entries of `ranking` in result.json, best first.
      found: (effect, location) of the effects that were named.
      threshold: score that a name needs; None if it is not shown.

    Returns:
      The figure.
    """
    shown = list(rows)[:_CANDIDATES]
    labels = [textwrap.fill(_capital(effect_at_place(row)), _WIDEST) for row in shown]
    lines = sum(1 + label.count("\n") for label in labels)
    figure = Figure(figsize=(7.2, 0.7 + 0.16 * lines + 0.09 * max(len(shown), 1)))
    axes = figure.subplots()
    scores = [max(float(row.get("score") or 0.0), 0.0) for row in shown]
    for i, (row, score) in enumerate(zip(shown, scores, strict=True)):
        best = (row["effect"], row["location"]) in set(found)
        same = bool(row.get("equivalent")) and not best
        axes.barh(
            i,
            score,
            height=0.62,
            color="#000000" if best else "#ffffff" if same else "#c4c4c4",
            edgecolor="#000000" if best or same else "#c4c4c4",
            hatch="/////" if same else None,
            linewidth=0.7,
        )
        note = format_number(float(row.get("score") or 0.0))
        if not best and row.get("margin"):
            behind = float(row["margin"])
            note += f"  ({'−' if behind > 0 else '+'}{format_number(abs(behind))})"
        axes.annotate(note, (score, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=7.5)
    axes.set_yticks(range(len(shown)), labels)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.5 * max([*scores, threshold or 1e-9]))
    if threshold is not None:
        axes.axvline(threshold, color="0.4", linewidth=0.8, linestyle=(0, (2, 2)), zorder=0)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("score (in brackets: distance to the first)", loc="right")
    return figure


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def force_data(arrays: Mapping[str, np.ndarray]) -> list[JointForce]:
    """Missing forces at joints, of joint_forces.npz."""
    keys = ("position", "velocity", "load", "time", "before", "after", "law", "spread")
    texts = zip(*([str(text) for text in arrays[key]] for key in ("joints", "units", "follows")), strict=True)
    return [
        JointForce(joint, unit, **{key: arrays[f"{key}_{n}"] for key in keys}, follows=tuple(follows.split()))
        for n, (joint, unit, follows) in enumerate(texts)
    ]


def force_figure(joints: Sequence[JointForce], mended: bool = True) -> Figure:
    """Missing force against position, velocity and load, or against what a law depends on; one row a joint.

    Args:
      joints: their missing force.
      mended: whether the force that is left beside a mended model is drawn.

    Returns:
      The figure.
    """
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
    """Numbers over sets of recordings, a panel each.

    Args:
      rows: of sets.csv.

    Returns:
      The figure.
    """
    keys = list(dict.fromkeys((r["effect"], r["location"], r["parameter"]) for r in rows))
    figure = Figure(figsize=(7.2, 0.5 + 1.5 * len(keys)))
    axes = figure.subplots(len(keys), 1, squeeze=False)[:, 0]
    for panel, key in zip(axes, keys, strict=True):
        own = [r for r in rows if (r["effect"], r["location"], r["parameter"]) == key]
        at = np.array([r["set"] for r in own])
        value, low, high = (np.array([r[name] for r in own], float) for name in ("value", "low", "high"))
        panel.errorbar(at, value, [value - low, high - value], color="black", marker="o", capsize=3, linewidth=1.1)
        panel.set_title(_capital(effect_at_place(own[0])), loc="left", fontsize=8)
        panel.set_ylabel(f"{key[2]} [{own[0]['unit']}]")
        panel.set_xticks(at, [str(r["name"]) for r in own])
    return figure


def commands(time: np.ndarray, values: np.ndarray, names: Sequence[str]) -> Figure:
    """A proposed command: the channels with the largest range.

    Args:
      time: (K,) times [s].
      values: (K, n) commands.
      names: (n,) names of the channels.

    Returns:
      The figure.
    """
    chosen = np.argsort(-np.ptp(values, axis=0), kind="stable")[:_CHANNELS]
    figure = Figure(figsize=(7.2, 2.2))
    axes = figure.subplots()
    for k, style in zip(chosen, ("-", "--", ":", "-.", (0, (6, 2, 1, 2, 1, 2))), strict=False):
        axes.plot(time, values[:, k], linestyle=style, linewidth=1.1, label=names[k])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("command\n[own unit]")
    figure.legend(loc="outside upper left", ncols=5)
    return figure

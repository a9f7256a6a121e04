"""The fields of ``diagnosis.json`` and the channels of ``diagnosis.nc``, from what a search says."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.binning import Run, further_of, measured_of
from shj_bayes.mismatch.data import BinnedData
from shj_bayes.mismatch.findings import Answer, FoundEffect, Reason, curve_band, rivals_of
from shj_bayes.mismatch.heldout import PARTS, HeldOut, Proven, cycles_of
from shj_bayes.mismatch.hypothesis import TEETH
from shj_bayes.mismatch.laplace import Laplace, drawn_from
from shj_bayes.mismatch.moves import LARGEST_OF, Search
from shj_bayes.mismatch.periodic import EQUATION, SHOWS, STATEMENT, SURE
from shj_bayes.mismatch.regions import WORDS, formula_of, run_of
from shj_bayes.model.effects.effect import Effect, catalogue
from shj_bayes.model.history import coordinate_of
from shj_bayes.model.parameters import LAW_PARAMETERS, base_and_run
from shj_bayes.results import diagnosis as records
from shj_bayes.results.codec import finite

Draws = Mapping[str, FloatArray]


def spread(values: FloatArray) -> dict[str, float]:
    """Mean, standard deviation, median and 90 % interval of draws: the fields of a `DrawsInShort`."""
    quantiles = np.quantile(values, [0.05, 0.5, 0.95]).tolist()
    mean, sd = float(values.mean()), float(values.std(ddof=1))
    return {"mean": mean, "sd": sd, **dict(zip(("q05", "q50", "q95"), quantiles, strict=True))}


def effects(out: Search, answer: Answer, draws: Draws) -> tuple[records.EffectRecord, ...]:
    """Mechanisms that were found; under the verdict ``unknown`` they are a part of what was left out."""
    found, partial = [], answer.verdict is records.DiagnosisVerdict.UNKNOWN
    for finding in answer.findings:
        effect, curve = finding.member.variant.effect, finding.member.variant.curve
        if not finding.named:
            continue
        own = {p.name: draws[f"{effect.id}.{p.name}"] for p in effect.parameters}
        units = {p.name: p.unit for p in effect.parameters}
        told: dict[str, Any] = {}
        if curve is not None:  # over a further channel: its change over the range
            over = out.data.blocks[0].history.measured[curve.coordinate]
            ends = curve.rows(np.array([0.0, 1.0]), np.ones(2))
            own = {"change": (ends[1] - ends[0]) @ np.stack([own[name] for name in curve.names])}
            told = {"low": over.low, "high": over.high, "unit": f" {over.unit}" if over.unit else ""}
        # A mean lies beyond what fits where a size is hardly known.
        middle = {key: float(np.median(values)) for key, values in own.items()}
        found.append(
            records.EffectRecord(
                id=effect.mechanism,
                form=effect.form,
                family=effect.family,
                title=effect.title,
                statement=effect.statement.format(**middle, **told),
                equation=effect.equation,
                cause=effect.cause,
                shows=effect.shows,
                partial=partial,
                probability=finding.probability * finding.names[0][1],
                rivals=tuple(name for name in _rivals(out, answer, finding) if name != effect.mechanism),
                size_kN=finding.size * out.data.scale_kN,
                parameters={
                    name: records.EffectParameter(**spread(own[name]), unit=units.get(name, "1")) for name in own
                },
            )
        )
    if chatter := out.chatter:
        effect = _chattering()
        found.append(
            records.EffectRecord(
                id=effect.id,
                form="chatter",
                family=effect.family,
                title=effect.title,
                statement=STATEMENT.format(size=chatter.size, share=chatter.share),
                equation=EQUATION,
                cause=effect.cause,
                shows=SHOWS,
                partial=partial,
                probability=SURE,
                size_kN=chatter.size * out.data.scale_kN,
                parameters={"size": records.EffectParameter(**spread(chatter.of_strokes), unit="1")},
            )
        )
    return tuple(found)


def _chattering() -> Effect:
    """Mechanism that chatter is a face of."""
    return next(e for e in catalogue().values() if TEETH in e.acts)


def modelled(answer: Answer, draws: Draws) -> dict[str, dict[str, float]]:
    """Median of each parameter of the effects in the model that is shown, by effect; curves are effects too.

    Not the mean: a length or a time that is hardly known has one far beyond what fits.
    """
    shown = answer.shown.state.model.effects if answer.findings else ()
    return {e.id: {p.name: float(np.median(draws[f"{e.id}.{p.name}"])) for p in e.parameters} for e in shown}


def _rivals(out: Search, answer: Answer, finding: FoundEffect) -> list[str]:
    """Mechanisms that may stand in the place of one: by another formula, or by a class that another set holds there."""
    others = {
        name
        for key, _ in rivals_of(answer)
        if finding.member.of.id not in key
        for name in key - frozenset(f.member.of.id for f in answer.findings)
    }
    return [name for name, _ in finding.names] + [e for name in sorted(others) for e in mechanisms(out, answer, name)]


def mechanisms(out: Search, answer: Answer, name: str) -> list[str]:
    """Mechanisms of a class; of one that was fitted with a formula, that of the formula."""
    for finding in answer.findings:
        if finding.member.of.id == name and finding.named:
            return [mechanism for mechanism, _ in finding.names]
    for h in answer.alternatives.values():
        for member in h.members:
            if member.of.id == name and member.variant.curve is None:
                return [member.variant.effect.mechanism]
    of = out.fitter.classes[name]
    if of.coordinate in out.data.blocks[0].history.measured:
        return [of.coordinate]
    known = [e for e in catalogue().values() if (of.action, of.coordinate) in e.acts and not e.form]
    return [e.id for e in known if e.id not in out.fitter.hidden]


def family(out: Search, answer: Answer) -> tuple[records.Member, ...]:
    """Mechanisms that the recording cannot tell apart, most probable first."""
    if answer.verdict is not records.DiagnosisVerdict.FAMILY:
        return ()
    listed: dict[str, float] = {}
    sure = frozenset.intersection(*(key for key, _ in rivals_of(answer)))
    for key, probability in rivals_of(answer):
        for name in sorted(key - sure):
            for effect in mechanisms(out, answer, name) or [out.fitter.classes[name].coordinate]:
                listed[effect] = min(listed.get(effect, 0.0) + probability, 1.0)
    for finding in answer.findings:
        if finding.member.of.id in sure and len(finding.names) > 1:
            listed |= {name: finding.probability * p for name, p in finding.names}
    return tuple(records.Member(id=k, probability=v) for k, v in sorted(listed.items(), key=lambda item: -item[1]))


def coordinates(out: Search, answer: Answer) -> tuple[records.DependenceRecord, ...]:
    """List what the force depends on beyond the base law, most probable first; push and pull may have a row each."""
    found = {finding.member.of.id: finding for finding in answer.findings}
    rows: list[records.DependenceRecord] = []
    for name, probability in sorted(answer.inclusion.items(), key=lambda item: -item[1]):
        finding = found.get(name)
        if finding is None and probability < 0.01:
            continue
        of = out.fitter.classes[name]
        row = records.DependenceRecord(
            coordinate=of.coordinate,
            unit=of.unit,
            action=of.action,
            probability=float(probability),
            evidence=finding.evidence if finding and np.isfinite(finding.evidence) else None,
            size_percent=100 * finding.size if finding else None,
            matches=tuple(mechanisms(out, answer, name)) if finding is None or finding.named else (),
        )
        bands = {d: curve_band(out, finding, direction=q) for d, q in finding.directions.items()} if finding else {}
        drawn = [
            replace(
                row,
                direction=direction,
                range_percent=float(np.ptp(band["mean"])),
                period=finding.curve.period if finding and finding.curve else None,
                curve=records.CurveRecord(
                    **{key: tuple(values.tolist()) for key, values in band.items()}, unit="% of Fy"
                ),
            )
            for direction, band in bands.items()
            if band is not None
        ]
        rows += drawn or [row]
    if answer.reason is Reason.FLUCTUATES or out.chatter:  # of the motion: surfaces stick, load up and jump
        rows.insert(
            0,
            records.DependenceRecord(
                coordinate=TEETH.coordinate,
                unit="1",
                action=TEETH.action,
                probability=SURE if out.chatter else 1.0,
                size_percent=100 * (out.chatter.size if out.chatter else LARGEST_OF * out.metric.fluctuation),
                matches=tuple(e.id for e in catalogue().values() if TEETH in e.acts and e.id not in out.fitter.hidden),
            ),
        )
    return tuple(rows)


def further(runs: Sequence[Run]) -> tuple[records.ChannelRecord, ...]:
    """List the further channels: the range of those that the force was held against, why the others were not."""
    measured = measured_of(runs)[0]
    rows = []
    for channel in further_of(runs):
        own = measured.get(coordinate_of(channel.name)) if channel.refused is None else None
        rows.append(
            records.ChannelRecord(
                name=channel.name,
                coordinate=coordinate_of(channel.name),
                unit=channel.unit,
                range=(own.low, own.high) if own else None,
                reference=own.reference if own else None,
                refused=channel.refused,
                share=channel.share,
            )
        )
    return tuple(rows)


def unknown(out: Search, answer: Answer) -> records.Unknown | None:
    """Describe what no mechanism explains: the curve, or where the rest is largest."""
    if answer.verdict is not records.DiagnosisVerdict.UNKNOWN:
        return None
    fy, strange = out.data.scale_kN, [f for f in answer.findings if not f.named]
    if answer.reason is not Reason.NO_FORM or not strange:
        residual = answer.shown.state.residual
        rows, coordinate = _profile(out.data, residual)
        size = max(answer.left_over * fy, float(np.sqrt(np.mean(residual[out.data.blocks.used > 0] ** 2))))
        return records.Unknown(coordinate=coordinate, shape=rows, size_kN=size)
    finding = strange[0]
    band, curve, of = curve_band(out, finding), finding.curve, finding.member.of
    assert band is not None
    assert curve is not None
    formula = formula_of(band["at"], band["mean"], band["q05"], band["q95"], curve.over.symbol, of.unit)
    push_kN = band["mean"] * fy / 100
    return records.Unknown(
        coordinate=WORDS.get(of.coordinate, of.coordinate),
        shape=_shape(band["at"], push_kN, -push_kN if of.action == "capacity" else push_kN),  # of friction it turns
        formula=f"{TERM[of.action]} = {formula}" if formula else None,
        period=records.Period(length=curve.period, unit=of.unit, coordinate=of.coordinate) if curve.period else None,
        size_kN=finding.size * fy,
    )


TERM = {"capacity": "change of Fy [%]", "added": "added force [% of Fy]", "motion": "change of the motion"}
Shape = tuple[Mapping[str, float | None], ...]


def _shape(*columns: FloatArray) -> Shape:
    """Rows of a table of the force in push and in pull over the middles of intervals."""
    names = ("centre", "push_kN", "pull_kN")
    return tuple(dict(zip(names, finite(row), strict=True)) for row in np.column_stack(columns).tolist())


def _profile(data: BinnedData, residual: FloatArray, n: int = 24) -> tuple[Shape, str]:
    """Mean residual over the coordinate over which it is most regular, push and pull."""
    best: tuple[float, Shape, str] = (-1.0, (), "")
    sense = np.sign(data.blocks.channel("direction"))
    for name, word in (("position_mm", "position"), ("slip_mm", "slip since reversal"), ("travel_m", "travel"),
                       ("speed_mm_s", "speed")):  # fmt: skip
        values = data.blocks.channel(name)
        edges = np.linspace(values.min(), values.max() * (1 + 1e-9) + 1e-9, n + 1)
        sides = [(sense == sign) & (data.blocks.used > 0) for sign in (1.0, -1.0)]
        count = np.stack([np.histogram(values[own], edges)[0] for own in sides])
        total = np.stack([np.histogram(values[own], edges, weights=residual[own])[0] for own in sides])
        taken = float(np.sum(total**2 / np.maximum(count, 1)))
        if taken > best[0]:
            means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
            best = (taken, _shape((edges[:-1] + edges[1:]) / 2, *means), word)
    return best[1], best[2]


def quality(data: BinnedData, state: Laplace, noise_kN: float, held: HeldOut) -> records.FitQuality:
    """Say how well a model fits: residual, noise, held-out residual (kN), energy per cycle (per cent)."""
    used = data.blocks.used > 0
    measured = energy_of(data, data.blocks.force_kN)
    modelled = energy_of(data, data.blocks.force_kN - state.residual)
    wrong = np.abs(modelled - measured) / np.maximum(np.abs(measured), 1e-300)
    return records.FitQuality(
        rmse_kN=float(np.sqrt(np.mean(state.residual[used] ** 2))),
        noise_kN=noise_kN,
        heldout_rmse_kN=held.rmse_kN,
        energy_error_percent=float(100 * np.mean(wrong)),
    )


def energy_of(data: BinnedData, force_kN: FloatArray) -> FloatArray:
    """Energy of each cycle, J (kN mm), by the trapezoid rule over the displacement."""
    cycle = cycles_of(data)
    work = np.append((force_kN[1:] + force_kN[:-1]) / 2 * np.diff(data.blocks.channel("position_mm")), 0.0)
    work[np.flatnonzero(np.diff(cycle))] = 0.0  # the step from one cycle, or run, to the next
    return np.asarray(np.bincount(cycle, weights=work), dtype=np.float64)


def energy(data: BinnedData, base: Laplace, shown: Laplace) -> records.EnergyRecord:
    """Energy of each cycle, measured and modelled before and after, J."""
    forces = data.blocks.force_kN, data.blocks.force_kN - base.residual, data.blocks.force_kN - shown.residual
    measured, before, after = (tuple(energy_of(data, force).tolist()) for force in forces)
    cycle = tuple(float(i) for i in range(1, len(measured) + 1))
    return records.EnergyRecord(cycle=cycle, measured_J=measured, before_J=before, after_J=after)


def heldout(shown: Proven) -> records.HeldOutRecord:
    """Gain of the shown model over the base law on cycles that were left out, and what was dropped for want of one."""
    gain, n = shown.gain, shown.held[0].count.size
    return records.HeldOutRecord(
        scheme=f"every {min(PARTS, n)}th cycle left out, {min(PARTS, n)} fits",
        elpd_gain=gain.elpd,
        se=gain.elpd_se,
        rmse_se_kN=gain.rmse_se_kN,
        n_blocks=n,
        dropped=shown.dropped,
    )


def shift(before: Draws, after: Draws) -> dict[str, records.Shift]:
    """Say what the omission did to the parameters of the base law, from draws without and with the effects found."""
    base = [name for name in before if "." not in name]  # not of effects that were given
    shared = [name for name in base if name in after and base_and_run(name)[0] in LAW_PARAMETERS]
    return {
        n: records.Shift(
            before=records.DrawsInShort(**spread(before[n])), after=records.DrawsInShort(**spread(after[n]))
        )
        for n in shared
    }


def next_test(shown: Proven, *, quick: bool) -> str | None:
    """Give the cheapest change of the test that would tell the leading rivals apart, and the command that plans one.

    Where nothing that was found improves what was left out, that which would show whether the first of it is there.
    """
    out, answer = shown.out, shown.answer
    known = {c.of.coordinate: c.variant.effect for c in out.fitter.looked} | catalogue()
    if answer.reason is Reason.NOT_BORNE_OUT:
        names = mechanisms(out, answer, shown.dropped[-1].class_)
        return known[names[0]].next_test if names and names[0] in known else None
    if answer.verdict is not records.DiagnosisVerdict.FAMILY:
        return None
    members = [member.id for member in family(out, answer)]
    said = list(dict.fromkeys(known[name].next_test for name in members[:2]))
    if answer.reason is Reason.SEVERAL:  # a plan weighs sets of coordinates, not formulas over one
        first = "diagnose without --quick, then " if quick else ""
        said.append(f"Computed for this device and rig: {first}shj-bayes plan RESULTS -o next.")
    return " ".join(said)


def candidates(shown: Proven) -> tuple[records.CandidateRecord, ...]:
    """Every effect of the catalogue, with what its class gains on the base law alone and in the answer."""
    out, answer, dropped = shown.out, shown.answer, {one.class_ for one in shown.dropped}
    base = out.found[frozenset()]
    gains: dict[str, float] = {}
    sizes: dict[str, float] = {}
    for c in reversed(out.fitter.screen(base)):  # of each class the best one last
        gains[c.of.id] = c.gain
        sizes[c.of.id] = float(np.percentile(np.abs(c.change), 99)) if c.change.size else 0.0
    for key, h in out.found.items():
        if len(key) == 1:
            gains[next(iter(key))] = h.log_weight - base.log_weight
    taken = {f.member.of.id: f for f in answer.findings}
    kept = {f.member.variant.effect.mechanism: f.size for f in answer.findings if f.named}
    if out.chatter:
        kept[_chattering().id] = out.chatter.size
    rows = []
    for effect in catalogue().values():
        name = next(
            (name for name in (str(records.DependenceId(*acts)) for acts in effect.acts) if name in gains), None
        )
        if effect.form or effect.id in out.fitter.hidden or name is None:
            continue
        reasons = {
            "does not improve cycles that were left out": name in dropped,
            "kept": effect.id in kept,
            "not this: another form of the same dependence fits": name in taken and taken[name].named,
            "its curve is another one": name in taken,
            "not seen in the residual of the base law": gains[name] <= 0.0,
            "explained by what was kept": bool(answer.findings),
            "too small, or too improbable, to matter": True,
        }
        rows.append(
            records.CandidateRecord(
                id=effect.id,
                title=effect.title,
                family=effect.family,
                score=float(gains[name]),
                elpd_gain=float(gains[name]),
                probability=float(answer.inclusion.get(name, 0.0)),
                size_kN=kept[effect.id] * out.data.scale_kN if effect.id in kept else sizes.get(name, 0.0),
                kept=effect.id in kept,
                reason=next(reason for reason, true in reasons.items() if true),
            )
        )
    return tuple(sorted(rows, key=lambda row: (not row.kept, -(row.score or 0.0))))


def channels(data: BinnedData, base: Laplace, shown: Laplace) -> dict[str, FloatArray]:
    """Measured and modelled force over all that a page draws."""
    names = ("time_s", "position_mm", "speed_mm_s", "slip_mm", "travel_m")
    return {name: data.blocks.channel(name) for name in names} | {
        "direction": np.sign(data.blocks.channel("direction")),
        "run": run_of(data).astype(np.float64),
        "block": cycles_of(data).astype(np.float64),
        "weight": data.blocks.used,
        "force_kN": data.blocks.force_kN,
        "before_kN": data.blocks.force_kN - base.residual,
        "after_kN": data.blocks.force_kN - shown.residual,
    }


def draws_of(state: Laplace, seed: int) -> dict[str, FloatArray]:
    """Draw from the Gaussian around the most probable parameters of a model, natural units."""
    theta = state.model.laws.natural(drawn_from(state, 2000, seed))
    return dict(zip(state.model.law_names, theta.T[: state.z.size], strict=True))


def hypotheses(answer: Answer) -> tuple[records.SetProbability, ...]:
    """List the sets of classes that hold all but 5 % of the probability."""
    return tuple(records.SetProbability(classes=tuple(sorted(key)), probability=p) for key, p in rivals_of(answer))

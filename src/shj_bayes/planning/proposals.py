"""Protocols to choose from: designs that engineers would run, drawn ones, and changes of the best."""

import math
from dataclasses import replace

import numpy as np

from shj_bayes.planning.protocol import Protocol, ProtocolBlock, Waveform, table_1_protocol
from shj_bayes.planning.rig import Rig

AMPLITUDES = (0.08, 0.15, 0.25, 0.5, 0.75, 1.0)  # of the largest displacement
SPEEDS = (0.03, 0.1, 0.25, 0.5, 1.0)  # of the largest speed
RESTS_S = (10.0, 30.0, 60.0, 180.0)
MOST_BLOCKS = 10
MOST_REPEATS = 200  # of a design, however long the rig may run
SAMPLES = 36.0  # of a cycle, at least: reversals between few samples are not found again
TRIANGLES, RESTING = 0.3, 0.2  # shares of drawn blocks
SINE, TRIANGLE = Waveform.SINE, Waveform.TRIANGLE
# Share of the stroke, share of the speed, cycles, waveform, rest in s: one coordinate changes while others stand still.
DESIGNS: dict[str, tuple[tuple[float, float, int, Waveform, float], ...]] = {
    "one amplitude at several speeds": (
        (0.5, 1.0, 2, SINE, 0.0), (0.5, 0.1, 1, SINE, 0.0), (0.5, 0.3, 2, SINE, 0.0), (0.5, 1.0, 2, SINE, 0.0),
    ),
    "large and small in turn": (
        (1.0, 1.0, 1, SINE, 0.0), (0.15, 0.5, 2, SINE, 0.0), (1.0, 1.0, 1, SINE, 0.0), (0.15, 0.5, 2, SINE, 0.0),
        (0.5, 1.0, 2, SINE, 0.0),
    ),
    "the same before and after a rest": ((0.5, 1.0, 4, SINE, 0.0), (0.5, 1.0, 4, SINE, 180.0)),
    "constant speed, full stroke": ((1.0, 1.0, 2, TRIANGLE, 0.0), (1.0, 0.2, 1, TRIANGLE, 0.0)),
    "small, worn in, small again": (
        (0.25, 0.5, 3, SINE, 0.0), (1.0, 1.0, 3, SINE, 0.0), (0.25, 0.5, 3, SINE, 60.0), (0.25, 0.1, 1, SINE, 0.0),
    ),
    "falling amplitudes": (
        (1.0, 1.0, 2, SINE, 0.0), (0.75, 1.0, 2, SINE, 0.0), (0.5, 1.0, 2, SINE, 0.0), (0.25, 1.0, 2, SINE, 0.0),
        (0.1, 1.0, 2, SINE, 0.0),
    ),
    "rising and falling, slow and fast": (
        (0.08, 0.25, 3, SINE, 0.0), (0.25, 0.25, 3, SINE, 0.0), (0.5, 1.0, 2, SINE, 0.0), (1.0, 1.0, 2, SINE, 0.0),
        (1.0, 0.25, 1, SINE, 0.0), (0.5, 0.25, 1, SINE, 0.0), (0.25, 1.0, 3, SINE, 0.0), (0.08, 0.25, 3, SINE, 0.0),
        (0.25, 0.06, 1, SINE, 0.0), (1.0, 0.5, 2, SINE, 60.0), (0.25, 0.25, 3, SINE, 0.0),
    ),
}  # fmt: skip


def first_protocols(rig: Rig, rng: np.random.Generator, n_drawn: int) -> list[Protocol]:
    """Give Table 1 again, the designs as far as the time allows, and `n_drawn` drawn protocols.

    Table 1 comes first, whether the rig's time allows it or not: it is what the others are compared with.
    """
    out = [table_1_protocol(rig.max_stroke_mm, rig.max_speed_mm_s)]
    for name, rows in DESIGNS.items():
        blocks = [ProtocolBlock(a * rig.max_stroke_mm, v * rig.max_speed_mm_s, n, w, r) for a, v, n, w, r in rows]
        once = within(blocks, rig)
        repeats = min(MOST_REPEATS, math.ceil(60.0 * rig.max_minutes / sum(b.duration_s for b in blocks)))
        again = within(blocks * repeats, rig)
        out += [Protocol(name, once)] if once else []
        out += [Protocol(f"{name}, again", again)] if again != once else []
    for _ in range(n_drawn):
        drawn: list[ProtocolBlock] = []
        seconds = rng.uniform(0.3, 1.0) * 60.0 * rig.max_minutes
        while len(drawn) < MOST_BLOCKS and sum(b.duration_s for b in drawn) < seconds:
            drawn.append(_block(rig, rng))
        if kept := within(drawn, rig):
            out.append(Protocol("drawn", kept))
    return out


def changed(protocol: Protocol, rig: Rig, rng: np.random.Generator) -> Protocol | None:
    """Change one thing of a protocol: a block, the order, a rest, a repeat; None where nothing is left or changed."""
    blocks = list(protocol.blocks)
    if not blocks:
        return None
    i, j = (int(k) for k in rng.integers(len(blocks), size=2))
    other = _block(rig, rng)
    match int(rng.integers(8)):
        case 0:
            blocks[i], blocks[j] = blocks[j], blocks[i]
        case 1:
            blocks[i] = replace(blocks[i], amplitude_mm=other.amplitude_mm)
        case 2:
            blocks[i] = replace(blocks[i], speed_mm_s=other.speed_mm_s)
        case 3:
            blocks[i] = replace(blocks[i], cycles=max(1, blocks[i].cycles + int(rng.choice([-2, -1, 1, 2]))))
        case 4:
            blocks[i] = replace(blocks[i], waveform=SINE if blocks[i].waveform is TRIANGLE else TRIANGLE)
        case 5:
            blocks[i] = replace(blocks[i], rest_s=0.0 if blocks[i].rest_s else float(rng.choice(RESTS_S)))
        case 6:
            del blocks[i]
        case _:
            blocks.insert(j, other if rng.random() < 0.5 else blocks[i])  # a new block, or one again
    kept = within(blocks[:MOST_BLOCKS], rig)
    if not kept or kept == protocol.blocks:
        return None
    return Protocol(f"{protocol.name.removesuffix(', changed')}, changed", kept)


def within(blocks: list[ProtocolBlock], rig: Rig) -> tuple[ProtocolBlock, ...]:
    """Blocks in their order, as fast as the rate resolves, with fewer cycles or left out where the time is short."""
    left, out = 60.0 * rig.max_minutes, []
    for given in blocks:
        resolved = 2.0 * math.pi * given.amplitude_mm * rig.rate_Hz / SAMPLES  # a faster cycle has too few samples
        b = replace(given, speed_mm_s=min(given.speed_mm_s, resolved))
        for cycles in range(b.cycles, 0, -1):
            fewer = replace(b, cycles=cycles)
            if fewer.duration_s <= left:
                out.append(fewer)
                left -= fewer.duration_s
                break
    return tuple(out)


def _block(rig: Rig, rng: np.random.Generator) -> ProtocolBlock:
    """Draw a block; one that would take more than a third of the time is run faster."""
    amplitude = float(rng.choice(AMPLITUDES)) * rig.max_stroke_mm
    speeds = [v * rig.max_speed_mm_s for v in SPEEDS]
    third = 20.0 * rig.max_minutes
    able = [v for v in speeds if ProtocolBlock(amplitude, v, 1).duration_s <= third] or speeds[-1:]
    waveform = TRIANGLE if rng.random() < TRIANGLES else SINE
    rest = float(rng.choice([r for r in RESTS_S if r < third] or [0.0])) if rng.random() < RESTING else 0.0
    return ProtocolBlock(amplitude, float(rng.choice(able)), int(rng.integers(1, 5)), waveform, rest)

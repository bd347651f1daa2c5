"""The verdict on a rig in plain words: what it is good for, because of what, and what is weak."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from quadrig.rig.doubt.disagreement import Disagreement, disagreements
from quadrig.rig.doubt.lens_accuracy import accuracy_in_words, is_determined, poses_alone
from quadrig.rig.doubt.misfit import misfits
from quadrig.rig.doubt.residual_field import residual_field
from quadrig.rig.doubt.weaknesses import bent_sheets
from quadrig.rig.result import Rig
from quadrig.rig.words import counted, length, listed
from quadrig.single.arrays import median

Grade = Literal["good", "with care", "not yet"]

# Held-out framesets that miss this much more than those of the fit: the rig follows its noise, not the room.
_OVERFITTED = 3.0
# Pictures of the world leave this much (px) at best; sheets where no other was seen are foretold no better.
_USUAL_RMS = 0.1
PATTERN = 3.0
"""Residuals of a field that agree this much more than chance form a pattern: boards' own errors reach 2 on good real
lenses."""
# A View in its own sigmas against the rig; those of a rig that fits are near 1, and 99.9 % are below 2.
_CONTRADICTS = 3.0
# From this median of all Views on it is no single View that is wrong, but what is assumed of all of them.
_LOOSE = 2.0
# Four webcams whose clocks were found miss by 9, their focals within their sigmas; with clocks that were not found by
# 13 and more, and focals 3 sigmas off: no widening of sigmas covers that.
_BROKEN = 11.0
# Beyond a sigma of 20 degrees (rad) a turn is no small one, about which anything could be said; beyond a few metres a
# camera may stand anywhere in the room.
_ANY_TURN = 0.35
_ANYWHERE = 3.0


@dataclass(frozen=True)
class Verdict:
    """grade and headline; holds: of what the working accuracy that heads it holds, and of what not, or ""; then
    sentences: what is good, and what is weak with what to do about it."""

    grade: Grade
    headline: str
    holds: str
    good: tuple[str, ...]
    weak: tuple[str, ...]


def verdict(rig: Rig) -> Verdict:
    """What to believe of a rig."""
    views = disagreements(rig)
    weak, broken = _weak_points(rig, views), _is_broken(rig, views)
    grade = _grade(rig, weak, broken)
    return Verdict(grade, _headline(rig, grade, broken), _holds(rig), tuple(_good(rig)), weak)


def weak_points(rig: Rig) -> tuple[str, ...]:
    """All that is weak in a rig, or wrong with it, and what to do, the gravest first: the list that terminal, report
    and viewer show."""
    return _weak_points(rig, disagreements(rig))


def _weak_points(rig: Rig, views: Sequence[Disagreement]) -> tuple[str, ...]:
    apart = [sentence for each in rig.apart for sentence in each.weak]
    contradictions = _contradictions(views, len(rig.cameras))
    gravest = [*misfits(rig), *(contradictions if _is_broken(rig, views) else [])]
    said = [*gravest, *rig.missing.values(), *rig.weak, *apart]
    return tuple(dict.fromkeys([*said, *contradictions, *_patterns(rig)]))


def _is_broken(rig: Rig, views: Sequence[Disagreement]) -> bool:
    """Whether the Views do not fit together at all, so that no sigma of the rig is to be believed."""
    return bool(misfits(rig)) or _usual(views) > _BROKEN


def _grade(rig: Rig, weak: Sequence[str], broken: bool) -> Grade:
    if broken:
        return "not yet"
    if not rig.is_doubt_known:
        return "with care"
    if _unplaced(rig):
        return "not yet"
    unseparated = any(not camera.observable_focal for camera in rig.cameras)
    if unseparated or not is_determined(rig) or _overfitted(rig):
        return "not yet"
    # A bend is reckoned with: that a sheet has one is no reason for care.
    return "with care" if {*weak} - {*bent_sheets(rig)} else "good"


def _headline(rig: Rig, grade: Grade, broken: bool) -> str:
    if not rig.is_doubt_known:
        return "How sure this rig is cannot be said: the file that it comes from does not state it."
    if not is_determined(rig):
        if len(rig.cameras) == 1:
            return "Not to be used yet: nothing that its camera saw determines a lens."
        return "Not to be used yet: no point in the room can be triangulated by two of its cameras."
    unplaced = _unplaced(rig)
    if unplaced and not broken:
        stand = f"{listed(unplaced)} {'stand' if len(unplaced) > 1 else 'stands'}"
        return f"Not to be used yet: how {stand} to the others is not known all round; see what is weak."
    accuracy = accuracy_in_words(rig)
    if broken:
        return f"Not to be used yet: its Views do not fit together, whatever its own figures promise ({accuracy})."
    if grade == "not yet":
        return f"Not to be used yet, though its own figures promise {accuracy}: see what is weak."
    care = ", with care: see what is weak." if grade == "with care" else "."
    if len(rig.cameras) == 1 and rig.apart:
        alone = 1 + len(rig.lens_only)
        return (
            f"Good for the lenses of {alone} cameras, each by itself{care} "
            "Poses need a rectangle that two cameras see at one time."
        )
    return f"Good for {accuracy}{care}"


def _unplaced(rig: Rig) -> list[str]:
    """Cameras whose pose is open in some direction."""
    return [
        camera.name
        for camera in rig.cameras
        if rig.rotation_sigma(camera.name) > _ANY_TURN or rig.position_sigma(camera.name) > _ANYWHERE
    ]


def _holds(rig: Rig) -> str:
    """Of what the working accuracy holds, and what stands beside it: the noise of a point's own pixels, and the scale
    of all lengths."""
    figures = np.isfinite([rig.working_accuracy, rig.point_accuracy, rig.scale_sigma]).all()
    if len(rig.cameras) < 2 or poses_alone(rig) or not figures:
        return ""
    positions = np.array([camera.rig_from_camera.translation for camera in rig.cameras])
    span = float(np.linalg.norm(positions[:, None] - positions, axis=-1).max())
    scale = rig.scale_sigma * span
    advice = "; measure what came out of the printer, and give scale_sigma" if scale > rig.working_accuracy else ""
    return (
        f"{length(rig.working_accuracy)} is the rig's own part in the sigma of a triangulated point; with the noise "
        f"of its pixels it is {length(rig.point_accuracy)}. All lengths together are known to "
        f"{100 * rig.scale_sigma:.2g} %, {length(scale)} of the {length(span)} between its cameras: no picture shows "
        f"the scale of the prints{advice}."
    )


def _good(rig: Rig) -> list[str]:
    sentences = []
    if np.isfinite(rig.held_out_rms):
        sentences.append(
            f"Framesets held out of the fit are predicted to {rig.held_out_rms:.2f} px, those of the fit to "
            f"{rig.rms:.2f} px."
        )
    elif np.isfinite(rig.rms):
        sentences.append(f"The fit agrees with its Views to {rig.rms:.2f} px.")
    used = sum(not fit.rejected for fit in rig.fits)
    if rig.fits:
        sentences.append(f"{used} of {len(rig.fits)} Views by {counted(len(rig.cameras), 'camera')} took part.")
    if len(rig.cameras) > 1 and rig.is_doubt_known:
        worst = max(rig.cameras, key=lambda camera: rig.position_sigma(camera.name))
        sentences.append(
            f"Every camera's position is known to {length(rig.position_sigma(worst.name))} or better "
            f"(worst: {worst.name})."
        )
    return sentences


def _overfitted(rig: Rig) -> bool:
    return bool(np.isfinite(rig.held_out_rms) and rig.held_out_rms > _OVERFITTED * max(rig.rms, _USUAL_RMS))


def contradiction_limit(views: Sequence[Disagreement]) -> float:
    """Sigmas from which a View contradicts the rig more than the others do."""
    return _CONTRADICTS * max(1.0, _usual(views))


def _usual(views: Sequence[Disagreement]) -> float:
    sigmas = [one.sigmas for one in views if np.isfinite(one.sigmas) and not one.rejected]
    return median(sigmas) if sigmas else 1.0


def out_of_step(rig: Rig) -> float:
    """Median disagreement of the Views, in sigmas, where it is so large that no single View is to blame; else 0."""
    usual = _usual(disagreements(rig))
    return usual if usual > _LOOSE else 0.0


def _contradictions(every: Sequence[Disagreement], cameras: int) -> list[str]:
    usual, limit = _usual(every), contradiction_limit(every)
    sentences = []
    if usual > _LOOSE:
        together = "the cameras did not take their pictures at one instant, or " if cameras > 1 else ""
        sentences.append(
            f"half of the Views miss the rig by more than {usual:.1f} of their own sigmas: {together}a rectangle "
            "bends or moved too fast; hold it still for a moment in each place"
        )
    wrong = [one for one in every if one.sigmas > limit and not one.rejected]
    if wrong:
        worst = max(wrong, key=lambda one: one.sigmas)
        sentences.append(
            f"{len(wrong)} of {len(every)} Views contradict the rig far more than the others, the worst being "
            f"{worst.camera} on {worst.rectangle} at frameset {worst.frameset} ({worst.sigmas:.0f} sigmas): look "
            "whether the rectangle moved, bent or was half hidden there"
        )
    return sentences


def _patterns(rig: Rig) -> list[str]:
    sentences = []
    for camera in rig.cameras:
        pattern = residual_field(rig, camera.name).pattern
        if pattern > PATTERN:
            sentences.append(
                f"{camera.name}: its residuals form a pattern over the picture ({pattern:.0f} times chance): the "
                "lens model does not fit, or the rectangles are not flat; try another lens, or stiffer boards"
            )
    return sentences

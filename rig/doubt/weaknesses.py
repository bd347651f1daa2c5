"""What is weak in a rig, in words, and what would mend it."""

from collections.abc import Sequence

import numpy as np

from quadrig.rig.result import Camera, Rig, ViewFit, fits_by_camera
from quadrig.rig.words import listed, with_sigma
from quadrig.single.arrays import Floats
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Above this many per cent the focal is what limits distances measured with a camera.
_VAGUE_FOCAL = 0.02
# Fewer Views than this leave one bad View the power to move a camera.
_FEW_VIEWS = 5
# Held-out framesets that fit this much worse than those of the fit speak of a lens or an instant that does not hold.
_WORSE_HELD_OUT = 1.5
# Less than this (px) is beyond what any detector promises.
_NOTABLE = 0.1
# Of a picture this wide (px).
_USUAL_WIDTH = 1280
# Clocks that agree this well (s) displace a hand-held rectangle by less than a corner's noise.
_NOTABLE_OFFSET = 0.003
# Sigmas from which clocks are said to disagree: poses between framesets are a curve's, not the noise's of a corner.
_SURE_OFFSET = 5.0
# The share of a picture (in a grid of 4 x 4) below which the lens is a guess outside of what was covered.
_LITTLE_COVER = 0.4
_GRID = 4
# Sigmas from which a sheet is said not to be flat: by chance one in a thousand.
_BOWED = 3.3
# So many groups of rejected Views, and bent sheets, are named.
_NAMED = 3
# So many corners farthest out, most of which stray, are no chance: one of two hundred strays where a lens fits.
_EDGE = 20
# So many rectangles that nobody saw are named.
_MOST_UNSEEN = 8
# Fifths of a recording that disagree by this much more than noise explains, in variance, are worth a word.
_DISAGREES = 1.5


def weaknesses(rig: Rig) -> tuple[str, ...]:
    """Sentences, the gravest first; cameras that share a fault share a sentence."""
    sentences, fits = [], fits_by_camera(rig)
    for camera in rig.cameras:
        sentences += _of_camera(rig, camera, fits[camera.name])
    if np.isfinite(rig.held_out_rms) and rig.held_out_rms > max(_WORSE_HELD_OUT * rig.rms, rig.rms + _NOTABLE):
        sentences.append(
            f"framesets held out of the fit miss by {rig.held_out_rms:.2f} px against {rig.rms:.2f} px of the fit: "
            "show more rectangles, in more places"
        )
    if rig.dispersion > _DISAGREES:
        clocks = "clocks out of step, " if len(rig.cameras) > 1 else ""
        sentences.append(
            f"fifths of the recording disagree {np.sqrt(rig.dispersion):.1f} times as much as noise explains, and "
            f"all sigmas are widened by that: look for {clocks}a bent board, a lens that moved"
        )
    return (*sentences, *bent_sheets(rig), *_covered(rig), *clocks_apart(rig), *_rejected(rig.fits))


def _of_camera(rig: Rig, camera: Camera, fits: Sequence[ViewFit]) -> list[str]:
    sentences = []
    sigma = rig.focal_sigma(camera.name) / camera.intrinsics.focal
    if not camera.observable_focal:
        sentences.append(
            f"{camera.name}: its focal length and distance cannot be separated ({100 * sigma:.0f} %); "
            "tilt a rectangle by 30 degrees or more in front of it"
        )
    elif sigma > _VAGUE_FOCAL:
        sentences.append(f"{camera.name}: its focal is known to {100 * sigma:.1f} %; tilt the rectangles more")
    if camera.views < _FEW_VIEWS:
        sentences.append(
            f"{camera.name}: rests on {camera.views} View{'s' if camera.views != 1 else ''}; show it more"
        )
    if camera.remainder > _NOTABLE * camera.intrinsics.width / _USUAL_WIDTH:
        sentences.append(
            f"{camera.name}: its pictures differ from its lens model by {camera.remainder:.2f} px, smoothly; poses "
            "and sigmas reckon with it, other software will not know"
        )
    return sentences + _past_its_lens(camera, fits)


def _past_its_lens(camera: Camera, every: Sequence[ViewFit]) -> list[str]:
    """From where on outward the corners of a picture mostly stray, for which its lens model is at fault."""
    fits = [fit for fit in every if not fit.rejected]
    pixels = np.concatenate([np.zeros((0, 2)), *(fit.view.pixels for fit in fits)])
    strays = ~np.concatenate([np.zeros(0, bool), *(fit.used for fit in fits)])
    distance = np.linalg.norm(pixels - camera.intrinsics.principal_point, axis=1)
    outward = np.argsort(-distance)
    count = np.arange(1, len(outward) + 1)
    mostly = count[2 * np.cumsum(strays[outward]) > count]
    if not len(mostly) or mostly[-1] < _EDGE:
        return []
    outer = outward[: mostly[-1]]
    return [
        f"{camera.name}: its lens model does not hold beyond {distance[outer[-1]]:.0f} px from the middle, where "
        f"{strays[outer].sum()} of {len(outer)} corners stray and are left out; trust nothing seen there"
    ]


def bent_sheets(rig: Rig) -> list[str]:
    """Which sheets are not flat, as their Views show, in a sentence; [] where all may be."""
    bent = []
    for placed in rig.rectangles:
        height, sigma = placed.shape.off_plane(placed.rectangle) if placed.shape is not None else (0.0, 0.0)
        if height > _BOWED * sigma:
            bent.append((1e3 * height, f"{placed.name!r} spans {with_sigma(1e3 * height, 1e3 * sigma)} mm"))
    if not bent:
        return []
    most = [words for _, words in sorted(bent, reverse=True)]
    rest = [f"{len(most) - _NAMED} others less"] if len(most) > _NAMED else []
    return [f"not flat, which is reckoned with: {listed([*most[:_NAMED], *rest])}; stiffer sheets need it less"]


def _covered(rig: Rig) -> list[str]:
    cover = coverage(rig)
    little = [c for c in rig.cameras if len(c.free_lens) > 3 and cover[c.name] < _LITTLE_COVER]
    if not little:
        return []
    shares = [f"{100 * cover[c.name]:.0f} % of {c.name}" for c in little]
    return [f"corners covered little of the pictures, {listed(shares)}; a lens is a guess in the rest"]


def never_seen(rectangles: Sequence[Rectangle], views: Sequence[View]) -> list[str]:
    """That rectangles which were described are in no picture, in a sentence; [] where all are."""
    seen = {view.rectangle for view in views}
    names = [repr(rectangle.name) for rectangle in rectangles if rectangle.name not in seen]
    if not names:
        return []
    rest = len(names) - _MOST_UNSEEN
    named = [*names[:_MOST_UNSEEN], *([f"{rest} more"] if rest > 0 else [])]
    them = "it" if len(names) == 1 else "them"
    return [
        f"no camera saw {listed(named)}: show {them}, look whether marking and dictionary are those that were "
        f"printed, or take {them} out of rig.toml"
    ]


def clock_offsets(rig: Rig) -> tuple[str, dict[str, tuple[float, float]]]:
    """By how much later than a camera of that name each other takes its pictures of one stamp, and the sigma of that,
    s; none where no clock was compared.

    Against the clock of the camera that agrees with most others, for only differences of clocks can be known.
    """
    known = {camera.name: camera for camera in rig.cameras if camera.clock_offset}
    if not known:
        return "", {}
    offsets = np.array([camera.clock_offset for camera in known.values()])
    base = known[list(known)[int(np.argmin(np.abs(offsets[:, None] - offsets).sum(axis=0)))]]
    # No difference is less sure than both together: that of two cameras, about their mean, is as unsure as that.
    return base.name, {
        name: (camera.clock_offset - base.clock_offset, camera.clock_offset_sigma + base.clock_offset_sigma)
        for name, camera in known.items()
    }


def clocks_apart(rig: Rig) -> list[str]:
    """Which clocks disagree, in a sentence, [] where none do for sure."""
    base, offsets = clock_offsets(rig)
    when = [
        f"{with_sigma(1e3 * abs(late), 1e3 * sigma)} ms {'later' if late > 0 else 'earlier'} by {name}"
        for name, (late, sigma) in offsets.items()
        if abs(late) > max(_NOTABLE_OFFSET, _SURE_OFFSET * sigma)
    ]
    if not when:
        return []
    return [
        f"clocks disagree: against {base}, pictures of the same stamp were taken {listed(when)}; "
        "allowed for here, but other software will not know"
    ]


def coverage(rig: Rig) -> dict[str, float]:
    """For each camera the share of the fields of a 4 x 4 grid over its picture in which corners were used."""
    pixels: dict[str, list[Floats]] = {camera.name: [np.zeros((0, 2))] for camera in rig.cameras}
    for fit in rig.fits:
        if fit.view.camera in pixels:
            pixels[fit.view.camera].append(fit.view.pixels[fit.used])
    shares = {}
    for camera in rig.cameras:
        size = np.array([camera.intrinsics.width, camera.intrinsics.height])
        field = np.clip(np.concatenate(pixels[camera.name]) / size * _GRID, 0, _GRID - 1).astype(int)
        shares[camera.name] = float((np.bincount(field @ np.array([1, _GRID])) > 0).sum()) / _GRID**2
    return shares


def _rejected(fits: Sequence[ViewFit]) -> list[str]:
    out: dict[tuple[str, str], list[int]] = {}
    for fit in fits:
        if fit.rejected:
            out.setdefault((fit.view.camera, fit.view.rectangle), []).append(fit.view.frameset)
    if not out:
        return []
    most = sorted(out.items(), key=lambda item: -len(item[1]))
    named = [
        f"{camera} of {rectangle!r} in {f'frameset {seen[0]}' if len(seen) == 1 else f'{len(seen)} framesets'}"
        for (camera, rectangle), seen in most[:_NAMED]
    ]
    rest = sum(len(seen) for _, seen in most[_NAMED:])
    total = sum(len(seen) for seen in out.values())
    were = "was" if total == 1 else "were"
    return [f"{total} of {len(fits)} Views {were} rejected: {listed([*named, *([f'{rest} more'] if rest else [])])}"]

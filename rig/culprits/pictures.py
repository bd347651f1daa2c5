"""Views outside of their pictures, and lenses and corners of pictures of another size."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.priors import ENOUGH_POINTS
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig, fits_by_camera
from quadrig.rig.start.lenses_and_poses import views_alone
from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics, image_middle
from quadrig.single.solve.homography import homographies
from quadrig.single.view import View

# Corners that are found, or pointed at, lie in the picture, but for this share of its size.
_RIM = 0.05
# Further outside than this many sizes of the picture they are no corners of another size either.
_ABSURD = 4.0
# Of a camera's Views outside of its picture, from which it is the size of the picture that is wrong.
_OTHER_SIZE = 0.2
# Distances between corners of a View, as a homography has them, miss by less than this share through any lens.
_NOT_FLAT = 0.15
# Share of a camera's Views that are no pictures of flat things, from which it is the camera's fault: of corners at
# random it is half or more, of those in a wrong order a few.
_NO_PICTURES = 0.3
# A corner of a picture of half the width and height: so much of it holds all Views of a camera whose size is doubled.
_QUARTER = 0.55
# So many places (a twentieth of the picture apart) are all in that quarter by chance once in some thousand cameras.
_MANY_PLACES = 4
# Principal points of real cameras lie within a tenth of the larger side of the middle.
_OFF_CENTRE = 0.1


@dataclass(frozen=True, eq=False)
class Sound:
    """Cameras and Views with what cannot be right set aside, and what was said of it: of cameras left without Views
    by name, and of the rest."""

    cameras: tuple[CameraInput, ...]
    views: tuple[View, ...]
    lost: dict[str, str]
    said: tuple[str, ...]


def set_aside(cameras: Sequence[CameraInput], views: Sequence[View]) -> Sound:
    """Views outside of their pictures rejected, all of a camera where it is its picture's size that is wrong, and
    lenses of pictures of another size brought to theirs."""
    said, lost, sizes = [], {}, {camera.name: (camera.width, camera.height) for camera in cameras}
    outside = _outside(views, sizes)
    out = set()
    for name in dict.fromkeys(view.camera for view, far in zip(views, outside, strict=True) if far > _RIM):
        own = [i for i, view in enumerate(views) if view.camera == name]
        near = [i for i in own if _RIM < outside[i] < _ABSURD]
        if len(near) > max(1, _OTHER_SIZE * len(own)):
            out |= set(own)
            lost[name] = _outside_words(name, sizes[name], [views[i] for i in near])
            continue
        for i in own:
            if outside[i] > _RIM:
                out.add(i)
                said.append(_view_outside(views[i], sizes[name]))
    given = [_of_its_pictures(camera) for camera in cameras]
    said += [words for _, words in given if words]
    kept = tuple(view for i, view in enumerate(views) if i not in out)
    return Sound(tuple(camera for camera, _ in given), kept, lost, tuple(said))


def _outside(views: Sequence[View], sizes: dict[str, tuple[int, int]]) -> Floats:
    """How far (V,) the furthest corner of each View lies outside of its picture, as a share of the larger side."""
    counts = np.array([len(view.pixels) for view in views], int)
    if not counts.sum():
        return np.zeros(len(views))
    size = np.repeat([sizes.get(view.camera, (np.inf, np.inf)) for view in views], counts, axis=0)
    pixels = np.concatenate([view.pixels for view in views])
    past = np.fmax(np.fmax(-0.5 - pixels, pixels - size + 0.5).max(axis=1) / size.max(axis=1), 0.0)
    past = np.where(np.isfinite(pixels).all(axis=1) & np.isfinite(size).all(axis=1), past, 0.0)
    furthest = np.zeros(len(views))
    np.maximum.at(furthest, np.repeat(np.arange(len(views)), counts), past)
    return furthest


def _outside_words(name: str, size: tuple[int, int], views: Sequence[View]) -> str:
    x, y = np.concatenate([view.pixels for view in views]).max(axis=0)
    return (
        f"{name}: its corners lie outside of its picture of {size[0]}x{size[1]}, as far as ({x:.0f}, {y:.0f}): they "
        "were found in pictures of another size; check its width and height"
    )


def _view_outside(view: View, size: tuple[int, int]) -> str:
    x, y = view.pixels[np.abs(view.pixels).max(axis=1).argmax()]
    return (
        f"{view.camera} on {view.rectangle!r} in frameset {view.frameset}: its corners lie outside of its picture of "
        f"{size[0]}x{size[1]}, at ({x:.4g}, {y:.4g}); the View was not used: check how they were found"
    )


def _of_its_pictures(camera: CameraInput) -> tuple[CameraInput, str]:
    """The camera with its given lens scaled to its pictures where it is for others, and what to say of that."""
    lens = camera.intrinsics
    if lens is None or (lens.width, lens.height) == (camera.width, camera.height):
        return camera, ""
    scale = max(camera.width, camera.height) / max(lens.width, lens.height)
    same_shape = abs(scale * min(lens.width, lens.height) - min(camera.width, camera.height)) < 1
    values = lens.parameters.copy()
    values[0] *= scale
    middle = image_middle(camera.width, camera.height)
    values[1:3] = scale * (values[1:3] + 0.5) - 0.5 if same_shape else middle
    scaled = Intrinsics.centred(camera.width, camera.height, 1.0, lens.model).with_parameters(values)
    words = (
        f"{camera.name}: the lens that was given is for pictures of {lens.width}x{lens.height}, another size than "
        f"its own {camera.width}x{camera.height}; it was scaled to these: check that nothing was cropped"
    )
    return replace(camera, intrinsics=scaled, fixed=camera.fixed and same_shape), words


def no_pictures(problem: Problem) -> dict[str, str]:
    """A sentence for each camera of which many Views are no pictures of flat things, whatever its lens."""
    observations = views_alone(problem).thinned(ENOUGH_POINTS)
    wrong = np.zeros(len(problem.views), bool)
    for group in observations.groups:
        homography = homographies(group.points[..., :2], group.pixels, group.weights)
        plane = np.concatenate([group.points[..., :2], np.ones((*group.points.shape[:2], 1))], axis=2)
        seen = plane @ np.swapaxes(homography, 1, 2)
        carries = group.weights > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            miss = np.where(carries[..., None], seen[..., :2] / seen[..., 2:] - group.pixels, 0.0)
            spread = np.where(carries[..., None], group.pixels - group.pixels[:, :1], 0.0)
            near = (miss**2).sum(axis=(1, 2)) < _NOT_FLAT**2 * (spread**2).sum(axis=(1, 2))
        # A picture has all of a plane's points on one side of its horizon.
        ahead = np.where(carries, np.sign(seen[..., 2]), 0.0).sum(axis=1)
        wrong[group.view] = ~near | (np.abs(ahead) < carries.sum(axis=1))
    sentences = {}
    for row, camera in enumerate(problem.cameras):
        own = problem.camera == row
        if wrong[own].sum() > max(1, _NO_PICTURES * own.sum()):
            sentences[camera.name] = (
                f"{camera.name}: {wrong[own].sum()} of its {own.sum()} Views are no pictures of any flat rectangle, "
                "whatever its lens: check how its corners were found, and in which order they are given"
            )
    return sentences


def size_sentences(rig: Rig) -> list[str]:
    """The cameras all of whose corners, in many places or with the principal point too, are those of a picture of
    half the width and height."""
    sentences, fits = [], fits_by_camera(rig)
    for camera in rig.cameras:
        lens = camera.intrinsics
        views = [fit.view for fit in fits[camera.name]]
        places = _places_in_quarter(views, (lens.width, lens.height))
        off = (lens.principal_point - image_middle(lens.width, lens.height)) / max(lens.width, lens.height)
        if places >= _MANY_PLACES or (places > 1 and off.max() < 0 and off.min() < -_OFF_CENTRE):
            sentences.append(_quarter_words(camera.name, lens.width, lens.height))
    return sentences


def in_a_quarter(problem: Problem, name: str) -> str:
    """That all corners of a camera are those of a picture of half the width and height, in words; else empty."""
    camera = next(one for one in problem.cameras if one.name == name)
    views = [view for view in problem.views if view.camera == name]
    if _places_in_quarter(views, (camera.width, camera.height)) < 2:
        return ""
    return _quarter_words(name, camera.width, camera.height)


def _places_in_quarter(views: Sequence[View], size: tuple[int, int]) -> int:
    """In how many places a camera's Views are, where all are in the upper left quarter of its picture; else 0."""
    if not views or not (np.concatenate([view.pixels for view in views]) < _QUARTER * np.array(size)).all():
        return 0
    return len({tuple(np.round(view.pixels.mean(axis=0) / (_RIM * max(size))).astype(int)) for view in views})


def _quarter_words(name: str, width: int, height: int) -> str:
    return (
        f"{name}: all of its corners lie in the upper left quarter of its picture of {width}x{height}, as if "
        "they were found in pictures of another size; check its width and height"
    )

"""Pictures of marked sheets as a distorted camera would take them, with a known truth.

Each pixel is the mean over its area of what its rays meet, in linear light; Capture says what a camera makes of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats, Mask, Picture, Reals, Singles
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture, for_all_colours, take_picture
from quadrig.single.render.marking_image import marking_image
from quadrig.single.render.room import Room, room_light

# Reflectance of printer's ink and of office paper.
_INK, _WHITE = 0.05, 0.82
# Two sheets nearer to each other than this (m) are taken to lie on each other: the later of the list is on top.
_THICKNESS = 2e-3
# Step (px) of the coarse search for the part of the image that a sheet covers.
_STRIDE = 4
# Sharpest texture kept (texels per metre) and largest (texels a side), which bound memory, not accuracy: a sheet
# that needs more fills the picture with one cell.
_DENSEST, _LARGEST = 40_000.0, 6_000
_PLAINLY = Capture()


@dataclass(frozen=True, eq=False)
class Sheet:
    """A marked rectangle somewhere in the world, on an opaque sheet that reaches `margin` metres beyond it.

    margin: the marking's quiet zone where None. texture (h, w) in [0, 1], 0 ink and 1 paper, stretched over the
    whole sheet, takes the place of the marking's picture. tone: reflectance of the paper.
    rounding: radius of the sheet's corners, metres.
    motion (6,): step of world_from_rect (Pose.retract) during the exposure, from half of it before to half after.
    The back of a sheet is blank, but for a rectangle with `back`: that is printed through.
    """

    rectangle: Rectangle
    world_from_rect: Pose
    texture: Reals | None = None
    margin: float | None = None
    tone: float = _WHITE
    rounding: float = 0.0
    motion: Floats | None = None

    @property
    def border(self) -> float:
        """Metres of sheet beyond the rectangle."""
        return self.rectangle.marking.quiet_zone(self.rectangle) if self.margin is None else self.margin

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the whole sheet, metres."""
        return self.rectangle.width + 2 * self.border, self.rectangle.height + 2 * self.border


@dataclass(frozen=True, eq=False)
class RayGrid:
    """The rays of every pixel of a camera: rays (h, w, 3) float32, unit length, nan where the lens has none."""

    intrinsics: Intrinsics
    rays: Singles


def ray_grid(intrinsics: Intrinsics) -> RayGrid:
    """The rays of all pixels; costs half a second for a distorted lens, so keep it for all pictures of a camera."""
    y, x = np.indices((intrinsics.height, intrinsics.width), float)
    rays = intrinsics.unproject(np.stack([x, y], axis=-1)).astype(np.float32)
    return RayGrid(intrinsics, rays)


def backdrop(grid: RayGrid, camera_from_world: Pose, room: Room) -> Singles:
    """The empty room (h, w, 3) float32, linear light: a background for all pictures of a camera that stands still."""
    return np.asarray(cv2.GaussianBlur(room_light(grid.rays, camera_from_world, room), (0, 0), 0.7), np.float32)


def render_image(
    camera: Intrinsics | RayGrid,
    camera_from_world: Pose,
    sheets: Sequence[Sheet],
    *,
    background: Room | Singles | float = 0.4,
    capture: Capture = _PLAINLY,
    samples: int = 3,
    colour: bool = True,
    rng: np.random.Generator | None = None,
) -> Picture:
    """The picture, uint8 (h, w, 3) blue green red, or (h, w) where colour is False.

    background: a Room, what `backdrop` made of it (h, w, 3) or (h, w), or one tone. capture: blur, noise, tone curve
    and all else between the light and the file. samples: rays a pixel along each axis. rng: of the noise; seed 0
    where None.
    """
    grid = camera if isinstance(camera, RayGrid) else ray_grid(camera)
    light = _background(grid, camera_from_world, background, colour)
    shape = light.shape[:2]
    canvas = _Canvas(light, np.full(shape, np.inf, np.float32), np.full(shape, -1, np.int16))
    for index in _order(sheets, camera_from_world):
        _paint(canvas, int(index), sheets[index], grid, camera_from_world, samples, capture.blur)
    return take_picture(canvas.light, capture, rng)


@dataclass(frozen=True, eq=False)
class _Canvas:
    """What is painted upon: light (h, w) or (h, w, 3), and of each pixel the distance (m) and the number of its
    sheet."""

    light: Singles
    depth: Singles
    owner: NDArray[np.int16]


def _order(sheets: Sequence[Sheet], camera_from_world: Pose) -> list[int]:
    """The farthest sheet first, but what lies on another after that, or its blurred edge would be painted over."""
    distances = [float(np.linalg.norm(camera_from_world.transform(s.world_from_rect.translation))) for s in sheets]
    order = sorted(range(len(sheets)), key=lambda k: -distances[k])
    for upper, sheet in enumerate(sheets):
        for lower in range(upper):
            rect_from_world = sheets[lower].world_from_rect.inverse()
            lies_on = abs(float(rect_from_world.transform(sheet.world_from_rect.translation)[2])) < _THICKNESS
            if lies_on and order.index(upper) < order.index(lower):
                order.remove(upper)
                order.insert(order.index(lower) + 1, upper)
    return order


def _background(grid: RayGrid, camera_from_world: Pose, background: Room | Singles | float, colour: bool) -> Singles:
    height, width = grid.rays.shape[:2]
    if isinstance(background, Room):
        background = backdrop(grid, camera_from_world, background)
    if isinstance(background, int | float):
        return np.full((height, width, 3) if colour else (height, width), background, np.float32)
    light = background.astype(np.float32, copy=True)
    if colour and light.ndim == 2:
        return np.asarray(cv2.cvtColor(light, cv2.COLOR_GRAY2BGR), np.float32)
    if not colour and light.ndim == 3:
        return np.asarray(cv2.cvtColor(light, cv2.COLOR_BGR2GRAY), np.float32)
    return light


def _paint(
    canvas: _Canvas, index: int, sheet: Sheet, grid: RayGrid, camera_from_world: Pose, samples: int, blur: float
) -> None:
    camera_from_rects = [
        camera_from_world @ pose for pose in _instants(sheet, camera_from_world, grid.intrinsics.focal)
    ]
    box = _box_of_all(camera_from_rects, sheet, grid, int(np.ceil(3 * blur)))
    if box is None:
        return
    # Instants of a motion lie apart like samples do: together they are as many as asked for.
    samples = max(1, -(-samples // len(camera_from_rects)))
    tone, alpha, nearest = _cast(camera_from_rects[0], sheet, grid.rays[box], samples, blur)
    for camera_from_rect in camera_from_rects[1:]:
        step_tone, step_alpha, step_depth = _cast(camera_from_rect, sheet, grid.rays[box], samples, blur)
        tone, alpha, nearest = tone + step_tone, alpha + step_alpha, np.minimum(nearest, step_depth)
    tone, alpha = tone / len(camera_from_rects), alpha / len(camera_from_rects)
    depth, owner, light = canvas.depth[box], canvas.owner[box], canvas.light[box]
    gap = nearest - depth
    on_top = (gap < -_THICKNESS) | ((gap < _THICKNESS) & (index > owner))
    alpha = np.where(on_top, alpha, 0)
    tone = np.where(on_top, tone, 0)
    mine = alpha > 0.5
    depth[mine] = nearest[mine]
    owner[mine] = index
    light[...] = light * for_all_colours(1 - alpha, light) + for_all_colours(tone, light)


def _instants(sheet: Sheet, camera_from_world: Pose, focal: float) -> list[Pose]:
    """Where the sheet is during the exposure: about one instant for each pixel that it moves."""
    if sheet.motion is None or not np.any(sheet.motion):
        return [sheet.world_from_rect]
    motion = np.asarray(sheet.motion, float)
    distance = np.linalg.norm(camera_from_world.transform(sheet.world_from_rect.translation))
    reach = np.linalg.norm(motion[3:]) + np.linalg.norm(motion[:3]) * max(sheet.size) / 2
    count = int(np.clip(2 * reach * focal / max(distance, 1e-3), 3, 32))
    return [sheet.world_from_rect.retract(motion * ((k + 0.5) / count - 0.5)) for k in range(count)]


def _plane_hits(camera_from_rect: Pose, rays: Singles) -> tuple[Singles, Singles, Singles, Mask]:
    """Where rays (..., 3) meet the plane: x, y (m, in the rectangle's frame), distance (m), and whether from the
    front. x and y are far away where they do not."""
    rect_from_camera = camera_from_rect.inverse()
    origin = rect_from_camera.translation.astype(np.float32)
    direction = rays @ rect_from_camera.rotation.T.astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -origin[2] / direction[..., 2]
    hit = distance > 0
    distance = np.where(hit, distance, np.float32(1e6))
    x = np.where(hit, origin[0] + distance * direction[..., 0], np.float32(1e6))
    y = np.where(hit, origin[1] + distance * direction[..., 1], np.float32(1e6))
    return x, y, distance, direction[..., 2] > 0


def _box_of_all(
    camera_from_rects: list[Pose], sheet: Sheet, grid: RayGrid, border: int
) -> tuple[slice, slice] | None:
    """Rows and columns of the image that hold the sheet at any instant, with a border of px, or None."""
    coarse = grid.rays[::_STRIDE, ::_STRIDE]
    half_width, half_height = sheet.size[0] / 2, sheet.size[1] / 2
    covered = np.zeros(coarse.shape[:2], bool)
    for camera_from_rect in camera_from_rects:
        x, y, distance, _ = _plane_hits(camera_from_rect, coarse)
        # A sheet smaller than the stride could fall between two rays: what a stride covers is added.
        slack = 2 * _STRIDE * distance / grid.intrinsics.focal
        covered |= (np.abs(x) < half_width + slack) & (np.abs(y) < half_height + slack) & (distance < 1e5)
    if not covered.any():
        return None
    rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    grow = _STRIDE + 2 + border
    return (
        slice(max(0, rows[0] * _STRIDE - grow), rows[-1] * _STRIDE + grow + 1),
        slice(max(0, columns[0] * _STRIDE - grow), columns[-1] * _STRIDE + grow + 1),
    )


def _cast(
    camera_from_rect: Pose, sheet: Sheet, rays: Singles, samples: int, blur: float
) -> tuple[Singles, Singles, Singles]:
    """Light of the sheet times its cover, its cover, and its distance, for rays (h, w, 3)."""
    x, y, distance, front = _plane_hits(camera_from_rect, rays)
    height, width = x.shape
    texture, density = _texture(sheet, _wanted_density(x, y, sheet, samples))
    map_x = (x + np.float32(sheet.size[0] / 2)) * np.float32(density[0]) + np.float32(0.5)
    map_y = (y + np.float32(sheet.size[1] / 2)) * np.float32(density[1]) + np.float32(0.5)
    if samples > 1:
        # Within a pixel the map is straight to 1e-4 px, so the finer map is the coarse one between its points.
        size = (width * samples, height * samples)
        map_x, map_y = (np.asarray(cv2.resize(one, size), np.float32) for one in (map_x, map_y))
    alpha = _mean_light(texture[1], map_x, map_y, samples, blur)
    if texture[0] is texture[1]:
        return sheet.tone * alpha * np.float32(_shade(camera_from_rect)), alpha, distance
    printed = _mean_light(texture[0], map_x, map_y, samples, blur)
    tone = np.where(front | sheet.rectangle.back, _INK * alpha + (sheet.tone - _INK) * printed, sheet.tone * alpha)
    return tone * np.float32(_shade(camera_from_rect)), alpha, distance


def _mean_light(texture: Picture, map_x: Singles, map_y: Singles, samples: int, blur: float) -> Singles:
    """Mean over each pixel's samples of a texture in [0, 1]; nothing lies beyond the texture."""
    fine = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    if blur > 0:
        # Before the pixels gather it, as in a lens: on whole pixels a small blur would not be a Gaussian.
        fine = cv2.GaussianBlur(fine, (0, 0), blur * samples, borderType=cv2.BORDER_REPLICATE)
    fine = fine.astype(np.float32)
    if samples > 1:
        size = (fine.shape[1] // samples, fine.shape[0] // samples)
        fine = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    return np.asarray(fine, np.float32) * np.float32(1 / 255)


def _shade(camera_from_rect: Pose) -> float:
    """A sheet that turns from the camera is a little darker: a lamp stands beside every camera."""
    return 0.72 + 0.28 * abs(float(camera_from_rect.rotation[2, 2]))


def _wanted_density(x: Singles, y: Singles, sheet: Sheet, samples: int) -> float:
    """Texels per metre that give about one texel a ray where the sheet is nearest to the camera."""
    inside = (np.abs(x) < sheet.size[0] / 2) & (np.abs(y) < sheet.size[1] / 2)
    step = np.hypot(np.diff(x, axis=1)[:-1], np.diff(y, axis=1)[:-1])[inside[:-1, :-1]]
    finest = float(np.percentile(step, 2)) if step.size else 1e-2
    wanted = min(samples / max(finest, 1e-9), _DENSEST, _LARGEST / max(sheet.size))
    # Steps of a quarter octave, so that a sheet that comes nearer is not drawn anew for every picture.
    return float(2 ** (np.ceil(4 * np.log2(wanted)) / 4))


def _texture(sheet: Sheet, density: float) -> tuple[tuple[Picture, Picture], tuple[float, float]]:
    """Two (h, w) in a border of one empty texel: share of paper, and cover; and texels per metre.

    The two are one and the same array where nothing is printed.
    """
    radius = sheet.rounding / max(sheet.size)
    if sheet.texture is None:
        both = _drawn(sheet.rectangle, density, sheet.border, radius)
    else:
        both = _bordered(sheet.texture, radius)
    height, width = both[0].shape
    return both, ((width - 2) / sheet.size[0], (height - 2) / sheet.size[1])


@lru_cache(maxsize=64)
def _drawn(rectangle: Rectangle, density: float, margin: float, radius: float) -> tuple[Picture, Picture]:
    return _bordered(marking_image(rectangle, density, margin), radius)


def _bordered(picture: Reals, radius: float) -> tuple[Picture, Picture]:
    cover = np.full(picture.shape, 255, np.uint8)
    if radius > 0:
        _round_off(cover, radius * max(cover.shape))
    levels = np.rint(cover * np.asarray(picture, np.float32)).astype(np.uint8)
    cover = np.pad(cover, 1)
    return (cover, cover) if np.all(picture == 1) else (np.pad(levels, 1), cover)


def _round_off(cover: Picture, radius: float) -> None:
    """Take away from a sheet's cover, texels, what lies beyond its rounded corners."""
    beyond = np.clip(radius - np.arange(int(radius) + 1) - 0.5, 0, None)
    rounded = 255 * np.clip(radius - np.hypot(beyond[:, None], beyond[None]) + 0.5, 0, 1)
    size = len(beyond)
    for part in (cover, cover[::-1], cover[:, ::-1], cover[::-1, ::-1]):
        part[:size, :size] = rounded

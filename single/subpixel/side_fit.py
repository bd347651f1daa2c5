"""The four sides of a sheet from short pieces of them, each with light of its own, that agree on where the side runs.

A shadow across an edge, or wood below it, changes the light along it; a hand hides a part of it. So each piece is
fitted by itself, the pieces of a side vote for a curve, and those that lie beside it are left out. How far the others
scatter around it says how sure the side is, whatever the ground does.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.subpixel.edge_fit import EdgeFit, EdgeOptions, Outline, fit_edges, meet
from quadrig.single.subpixel.tone import LightImage

# Share of what a ground's light varies by along the sides by which it varies from px to px across them.
_ACROSS = 0.05
# Factor by which noise that hangs together (JPEG) and both sides' levels raise that of a ratio of levels.
_GRAINY = 2.0
# Standard deviation of the log gamma that an uneven ground looks like, over its unevenness.
_TONE_OF_GROUND = 30.0
# Pieces of a side, px of the shortest, and of them beyond each of its ends.
_PIECES, _SHORTEST, _BEYOND = 24, 7.0, 2
# Lines of pixels across a piece that are looked at.
_LINES = 24
# Share of a side at either end that a rounded corner may take, and blurs that blur rounds.
_ROUNDED, _BLURRED = 0.06, 2.5
# A piece shows the edge where the sigma of its place (px) and its noise over its contrast are below these, and its
# contrast, grey levels, is above; noise of more than so many times its fellows' is something across the edge.
_SHOWN, _CLEAR, _LEAST_STEP, _UNLIKE = 0.6, 0.35, 3.0, 3.0
# Pieces agree within so many sigmas of their places, px at least and at most.
_AGREE, _NEAR, _FAR = 3.5, 0.35, 1.2
# Standard deviation of what a lens does to a point in the picture's corner, as share of the way from the middle, and
# of that part of a side's bow that follows no such cubic: share of it, and px at 100 px of a side of bent paper.
_LENS, _NOT_CUBIC, _BENT = 0.25, 0.15, 0.05
# Share of its own bow by which a side is bent unlike at its two ends.
_LOPSIDED = 0.5
# Pieces beside a gap that are left out with it, and those that are left of fewer beyond a longer gap: the border of
# glare or of a hand lies on the line of a side for so long.
_FROM_GAP, _SCRAP = 2, 2
# px^2 that a piece which does not show the edge is off by.
_HIDDEN = 1e6
# px that a ground may do to a piece: shares of it are alike over a part of half a side, and each piece's alone.
_GROUNDS = (0.0, 0.01, 0.02, 0.03, 0.045, 0.065, 0.1, 0.15, 0.22)
_ALIKE, _AT_ONCE, _ALONE = 0.4, 0.8, 0.2
# px by which grain along a side shifts all of it, over the ground's unevenness: nothing in the side shows that.
_GRAIN = 1.0
# Share of a side's step by which bare ground differs from place to place.
_SAME_GROUND = 0.25
# Share of a side's step that what goes on beyond its end must have, and px beside the side's own curve.
_SAME_STEP, _SAME_LINE = 0.65, 1.5


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides between corners (4, 2) px: offset outwards from the straight line, coefficients (4, 4) as in EdgeFit.

    seen (4, K): which pieces show it; bare (4, K): which show the ground on both sides. goes_on (4,): whether it runs
    past one of its ends. step (4,): logarithm of the light outside over that inside. ground: standard
    deviation of the light outside, as share of the contrast.
    outline: where the sides meet.
    """

    corners: Floats
    coefficients: Floats
    seen: Mask
    bare: Mask
    goes_on: Mask
    step: Floats
    ground: float
    outline: Outline


def fit_sides(
    image: LightImage,
    corners: Floats,
    bow: Floats,
    reach: float,
    blur: float,
    middle: Floats,
    ground: float,
    tone_unknowns: int = 1,
) -> Sides:
    """Fit the sides near those between corners (4, 2) px with coefficients (4, 4) of an earlier fit.

    reach: px to either side that belong to an edge alone. blur: px, as far as known. middle (2,) px: of the whole
    picture, from which a lens bends lines. ground: how uneven what it lies on is, see Sides. tone_unknowns:
    see EdgeOptions.
    """
    frame = _Frame.of(corners)
    count = int(np.clip(frame.half.min() * 2 / _SHORTEST, 4, _PIECES))
    places = _places(frame.half, count, blur)
    ends = frame.points(places, bow)
    start, end = ends[:, :-1].reshape(-1, 2), ends[:, 1:].reshape(-1, 2)
    # Beyond a corner, too, inside is where the side has it.
    inside = (start + end) / 2 - np.repeat(frame.normal, places.shape[1] - 1, axis=0) * reach
    reaches, margins = np.full(len(start), reach), np.zeros(len(start))
    options = EdgeOptions(_LINES, _ACROSS * ground, tone_unknowns=tone_unknowns)
    fit = fit_edges(image, start, end, inside, reaches, margins, options=options)
    pieces = _Pieces.of(frame, fit, start, end)
    own = np.arange(count) + _BEYOND + 1
    bows, own_bows = _bow_prior(frame, middle)
    shown = pieces.shown(own)
    agreeing = np.stack([_agreeing(pieces, side, shown[side], np.sqrt(bows[side, side])) for side in range(4)])
    pixels = max(reach * float(np.linalg.norm(end - start, axis=1).mean()), 1.0)
    seen = np.zeros_like(shown)
    seen[:, own] = _clear_of_gaps(agreeing[:, own])
    return _joined(frame, pieces, seen, own, _prior(bows, own_bows), fit, pieces.unevenness(seen, pixels))


@dataclass(frozen=True, eq=False)
class _Frame:
    """Sides between corners (4, 2): middle, tangent, outward normal (4, 2), half length (4,)."""

    corners: Floats
    middle: Floats
    tangent: Floats
    normal: Floats
    half: Floats

    @staticmethod
    def of(corners: Floats) -> "_Frame":
        along = np.roll(corners, -1, axis=0) - corners
        length = np.linalg.norm(along, axis=1)
        tangent = along / length[:, None]
        middle = corners + along / 2
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
        normal *= np.sign(np.sum((middle - corners.mean(axis=0)) * normal, axis=1))[:, None]
        return _Frame(corners, middle, tangent, normal, length / 2)

    def points(self, u: Floats, coefficients: Floats) -> Floats:
        """Points (4, K, 2) of the sides at u (4, K)."""
        offset = np.sum(coefficients[:, None] * u[..., None] ** np.arange(4), axis=-1)
        along = (self.half[:, None] * u)[..., None] * self.tangent[:, None]
        return self.middle[:, None] + along + offset[..., None] * self.normal[:, None]


def _places(half: Floats, count: int, blur: float) -> Floats:
    """Where along the sides, u, pieces begin and end: so many between
    the corners, one across each of them, and those beyond."""
    margin = np.minimum(np.maximum(_BLURRED * blur, 2 * _ROUNDED * half), 0.5 * half) / half
    inner = np.linspace(-1 + margin, 1 - margin, count + 1, axis=1)
    step = np.maximum(inner[:, 1] - inner[:, 0], _SHORTEST / half)[:, None]
    outer = 1 + margin[:, None] + step * np.arange(_BEYOND + 1)
    return np.concatenate([-outer[:, ::-1], inner, outer], axis=1)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Of each side (4, P): u, offset px, its variance, light inside and outside, grey contrast, noise over contrast;
    step: logarithm of the light outside over that inside."""

    u: Floats
    offset: Floats
    variance: Floats
    inner: Floats
    outer: Floats
    contrast: Floats
    unexplained: Floats

    @staticmethod
    def of(frame: _Frame, fit: EdgeFit, start: Floats, end: Floats) -> "_Pieces":
        middle, along = (start + end) / 2, end - start
        along /= np.linalg.norm(along, axis=1)[:, None]
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1).reshape(4, -1, 2)
        normal *= np.sign(np.sum(normal * frame.normal[:, None], axis=-1, keepdims=True))
        shift = middle.reshape(4, -1, 2) + normal * fit.coefficients[:, 0].reshape(4, -1, 1) - frame.middle[:, None]
        light = np.maximum(np.stack([fit.dark, fit.dark + fit.contrast]), 0.1)
        steep = np.maximum(np.abs(fit.contrast), 1e-3)
        parts = (
            np.sum(shift * frame.tangent[:, None], axis=-1) / frame.half[:, None],
            np.sum(shift * frame.normal[:, None], axis=-1),
            fit.covariance[:, 0, 0],
            light[0],
            light[1],
            fit.grey_contrast,
            fit.noise / steep,
        )
        return _Pieces(*(part.reshape(4, -1) for part in parts))

    @property
    def step(self) -> Floats:
        return np.log(self.outer / self.inner)

    def unevenness(self, seen: Mask, pixels: float) -> float:
        """Standard deviation of the ground's light over the contrast. A shadow takes the same share of both sides'
        light, and what is dark is none the surer of its share. pixels: on either side of a piece."""
        if not seen.any():
            return 0.0
        inner, outer = self.inner[seen], self.outer[seen]
        ratio = outer / inner
        beside, alone = np.std(ratio) / np.abs(np.mean(ratio) - 1), np.std(outer) / np.mean(np.abs(outer - inner))
        # What noise alone does to the levels of so many pixels is no ground.
        noise = _GRAINY * np.median(self.unexplained[seen]) / np.sqrt(pixels)
        return float(np.sqrt(max(min(beside, alone) ** 2 - noise**2, 0.0)))

    def bare(self, seen: Mask, step: Floats) -> Mask:
        """Which pieces (4, P) have on both sides the light that the side's seen pieces have outside; step (4,): of
        these."""
        ground = np.log(_typical(self.outer, seen))[:, None]
        like = [
            np.abs(np.log(light) - ground) < _SAME_GROUND * np.abs(step)[:, None]
            for light in (self.inner, self.outer)
        ]
        return like[0] & like[1] & ~seen

    def shown(self, own: Ints) -> Mask:
        """Which pieces (4, P) show a clear step, of the sense that most of all sides' have."""
        contrast = np.nan_to_num(self.contrast)
        sense = np.sign(np.median(contrast[:, own]))
        clear = (
            np.isfinite(self.offset) & (self.variance > 0) & (self.variance < _SHOWN**2) & (self.unexplained < _CLEAR)
        )
        clear &= contrast * sense > _LEAST_STEP
        for side in range(4):
            good = clear[side, own]
            if good.any():
                clear[side] &= self.unexplained[side] < _UNLIKE * np.median(self.unexplained[side, own][good]) + 0.05
        return clear


@lru_cache(maxsize=16)
def _triples(count: int) -> Ints:
    return np.array(list(combinations(range(count), 3)))


def _agreeing(pieces: _Pieces, side: int, shown: Mask, bow: float) -> Mask:
    """Which pieces of a side lie on the parabola that most of those shown within it agree on.

    A parabola through three of them that bends more than a lens bends it counts less (Torr and Zisserman, 2000)."""
    index = np.flatnonzero(shown & (np.abs(pieces.u[side]) < 1))
    if len(index) < 3:
        return np.zeros_like(shown)
    u, offset = pieces.u[side], pieces.offset[side]
    tolerance = np.clip(_AGREE * np.sqrt(np.maximum(pieces.variance[side], 0)), _NEAR, _FAR)
    triples = index[_triples(len(index))]
    powers = u[triples][..., None] ** np.arange(3)
    curves = np.linalg.solve(powers, offset[triples][..., None])[..., 0]
    apart = np.abs(curves @ (u[:, None] ** np.arange(3)).T - offset) / tolerance
    support = np.sum(np.maximum(0, 1 - apart[:, index] ** 2), axis=1) - 0.5 * (curves[:, 2] / bow) ** 2
    best = int(np.argmax(support))
    return shown & (apart[best] < 1)


def _clear_of_gaps(seen: Mask) -> Mask:
    """Pieces (4, K) with no gap near them: what hides an edge lies along it for a little before it leaves it."""
    count = seen.shape[1]
    around = np.pad(seen, ((0, 0), (_FROM_GAP, _FROM_GAP)), constant_values=True)
    clear = np.all([around[:, k : k + count] for k in range(2 * _FROM_GAP + 1)], axis=0)
    for side in clear:
        runs = np.split(np.arange(count), np.flatnonzero(np.diff(side)) + 1)
        for run, *beside in zip(runs, [[], *runs[:-1]], [*runs[1:], []], strict=True):
            if side[run[0]] and len(run) <= min(_SCRAP, max(map(len, beside))):
                side[run] = False
    return clear


def _bow_prior(frame: _Frame, middle: Floats) -> tuple[Floats, Floats]:
    """Covariance (4, 4) px^2 of the sides' bows: what one cubic lens bends them by and what is each one's own; and
    variance (4,) of that."""
    size = np.sum(middle**2)
    height = np.sum((frame.middle - middle) * frame.normal, axis=1)
    cubic = _LENS * height * frame.half**2 / size
    own = np.hypot(_NOT_CUBIC * cubic, _BENT * (2 * frame.half / 100) ** 2 + 0.02)
    return np.outer(cubic, cubic) + np.diag(own**2), own**2


def _prior(bows: Floats, own: Floats) -> Floats:
    """Precision (16, 16) of the sides' coefficients: lines anywhere, bows of a lens, and a little lopsided."""
    prior = np.zeros((16, 16))
    prior[2::4, 2::4], prior[3::4, 3::4] = np.linalg.inv(bows), np.diag(1 / (_LOPSIDED**2 * own))
    prior[0::4, 0::4] = prior[1::4, 1::4] = 1e-6 * np.eye(4)
    return prior


def _joined(
    frame: _Frame, pieces: _Pieces, seen: Mask, own: Ints, prior: Floats, fit: EdgeFit, uneven: float
) -> Sides:
    """All four sides by least squares: their lines are each one's own, their bows hang together."""
    coefficients, inverse = _solved(pieces, seen, prior, uneven)
    # A tone moves all of a side alike; what its pieces differ by in that is their noise.
    moved = [_typical(fit.by_tone[:, k, 0].reshape(seen.shape), seen) for k in range(fit.pull.shape[1])]
    by_tone = np.stack(moved, axis=1)[..., None] * [1, 0, 0, 0]
    step = _typical(pieces.step, seen)
    left = pieces.offset - np.sum(coefficients[:, None] * pieces.u[..., None] ** np.arange(4), axis=-1)
    same = pieces.step * np.sign(step)[:, None] > _SAME_STEP * np.abs(step)[:, None]
    on = same & (np.abs(left) < _SAME_LINE) & (pieces.unexplained < _CLEAR)
    goes_on = on[:, :_BEYOND].all(axis=1) | on[:, -_BEYOND:].all(axis=1)
    pull, weight, excess = (
        part.reshape(*seen.shape, *part.shape[1:]) for part in (fit.pull, fit.weight, fit.pull_excess)
    )
    pull, weight = (
        np.stack([one[mask].sum(axis=0) for one, mask in zip(part, seen, strict=True)]) for part in (pull, weight)
    )
    doubt = max(float(np.median(excess[seen])) if seen.any() else 1.0, _disagreement(pull, weight))
    doubt += float(weight[:, 0, 0].sum()) * (_TONE_OF_GROUND * uneven) ** 2
    noise, dark, contrast, blur = (
        _typical(part.reshape(seen.shape), seen) for part in (fit.noise, fit.dark, fit.contrast, fit.blur)
    )
    covariance = np.stack([inverse[k : k + 4, k : k + 4] for k in range(0, 16, 4)])
    whole = EdgeFit(
        coefficients,
        covariance,
        noise,
        dark,
        contrast,
        blur,
        by_tone,
        pull,
        weight,
        np.full(4, doubt),
        np.ones(4),
        fit.tone,
    )
    outline = meet(frame.corners[None], whole)
    bare = pieces.bare(seen, step)[:, own]
    return Sides(frame.corners, coefficients, seen[:, own], bare, goes_on, step, uneven, outline)


def _solved(pieces: _Pieces, seen: Mask, prior: Floats, uneven: float) -> tuple[Floats, Floats]:
    """Coefficients (4, 4) of the sides and their covariance (16, 16)."""
    powers = pieces.u[..., None] ** np.arange(4)
    # What hides a piece hides it wholly.
    variance = np.where(seen, np.maximum(pieces.variance, 1e-6), _HIDDEN)
    offset = np.where(seen, pieces.offset, 0)
    ground = _ground(powers, variance, offset, np.asarray(np.linalg.inv(prior), float)) + (_GRAIN * uneven) ** 2
    solve = np.swapaxes(powers, 1, 2) @ np.linalg.inv(variance[:, None] * np.eye(seen.shape[1]) + ground)
    inverse = np.asarray(np.linalg.inv(prior + _diagonal(solve @ powers)), float)
    return (inverse @ (solve @ offset[..., None]).reshape(16)).reshape(4, 4), inverse


def _typical(part: Floats, seen: Mask) -> Floats:
    """Median (4,) of values (4, P) over the pieces seen; nan where none is."""
    return np.array([np.median(row[mask]) if mask.any() else np.nan for row, mask in zip(part, seen, strict=True)])


def _disagreement(pull: Floats, weight: Floats) -> float:
    """Variance of what the sides (4, D), (4, D, D) say of the tone over that which they claim: a ground looks like a
    tone."""
    unknowns = pull.shape[1]
    inverse = np.linalg.inv(weight.sum(axis=0) + 1e-9 * np.eye(unknowns))
    apart = pull - weight @ (inverse @ pull.sum(axis=0))
    return float(np.sum((apart @ inverse) * apart)) / unknowns * 4 / 3


def _ground(powers: Floats, variance: Floats, offset: Floats, prior: Floats) -> Floats:
    """Covariance (P, P), px^2, of what the ground does to the pieces of a side, by the most likely of a few.

    powers (4, P, 4), variance and offset (4, P) of the pieces, prior (16, 16): covariance of the coefficients. The
    likelihood has the coefficients taken out of it, or what they explain would be missing from the ground.
    """
    distance = np.abs(powers[0, :, None, 1] - powers[0, None, :, 1])
    shape = _AT_ONCE * np.exp(-distance / _ALIKE) + _ALONE * np.eye(len(distance))
    seen = np.flatnonzero(variance.ravel() < _HIDDEN)
    design = _diagonal(powers)
    explained = (design @ prior @ design.T + np.diag(variance.ravel()))[np.ix_(seen, seen)]
    shapes = _diagonal(np.broadcast_to(shape, (4, *shape.shape)))[np.ix_(seen, seen)]
    values = offset.ravel()[seen]
    best, most = 0.0, -np.inf
    for amount in _GROUNDS:
        root = np.linalg.cholesky(explained + amount**2 * shapes)
        likelihood = -0.5 * float(np.sum(np.linalg.solve(root, values) ** 2)) - float(np.sum(np.log(np.diag(root))))
        if likelihood > most:
            best, most = amount, likelihood
    return best**2 * shape


def _diagonal(blocks: Floats) -> Floats:
    """A matrix (4 R, 4 C) with blocks (4, R, C) along its diagonal."""
    count, rows, columns = blocks.shape
    whole = np.zeros((count, rows, count, columns))
    whole[np.arange(count), :, np.arange(count)] = blocks
    return whole.reshape(count * rows, count * columns)

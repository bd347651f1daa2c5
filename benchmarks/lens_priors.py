"""Learn what lenses people use from a table of published calibrations, and write single/lens_table.py.

Each part of a lens (radial terms, principal point, tangential terms, aspect, focal) is a mixture of Gaussians, fitted
by expectation-maximisation with one vote a repository. Terms that a calibration held fixed are missing, not zero.
Badly made calibrations: sensors have square pixels, so a calibration's own aspect shows how well it was made (where
it is off by more than 0.4 %, tangential terms are seven times as large as where it is off by less than 0.07 %).
Principal points and tangential terms are learned from those that are off by less than 0.15 %; of the aspect the
widest of three components is taken for error and left out. Radial terms have a wide component of their own.

    python benchmarks/lens_priors.py ../shared/data/lenses/lenses.csv single/lens_table.py
"""

import csv
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from quadrig.single.arrays import Floats, Mask

# Words of the table's notes that say a row is no lens of its own.
_NOT_A_LENS = ("wild", "swapped", "anamorphic")
# A class is not narrower than this (of the half picture): what a fifth of the rows could teach, and calibrations err.
_LEAST_SPREAD = np.array([0.02, 0.01, 0.005])
_LEAST_SPREAD_ROWS = 4.0
_ROUNDS = 60
# A calibration whose pixels are square to this is well made: a third of those of which the aspect was free.
_SQUARE = 0.0015

_HEAD = '''"""What lenses people use, learned from published calibrations: benchmarks/lens_priors.py writes this file.

{count} cameras of {repositories} repositories. Radial terms are in parts of the picture: k1 s^2, k2 s^4, k3 s^6 with
s the tangent at half the larger side, (side / 2) / focal.
"""

'''


def rows_of(path: Path, model: str) -> tuple[list[dict[str, str]], Floats]:
    """The rows of a lens model, and the weight of each: one vote a repository."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == model]
    rows = [row for row in rows if not any(word in row["note"] for word in _NOT_A_LENS)]
    votes = Counter(row["source_repo"] for row in rows)
    return rows, np.array([1 / votes[row["source_repo"]] for row in rows])


def _number(row: dict[str, str], key: str, unless: str = "-") -> float:
    return np.nan if unless in row["note"] or not row[key] else float(row[key])


def _side(row: dict[str, str]) -> float:
    return max(float(row["width"]), float(row["height"]))


def _half(row: dict[str, str]) -> float:
    return _side(row) / 2 / float(row["fx"])


def log_density(values: Floats, mean: Floats, covariance: Floats) -> Floats:
    """Of rows (N, D) under a Gaussian, what is missing (nan) left out."""
    known = np.isfinite(values)
    code = known @ (1 << np.arange(values.shape[1]))
    result = np.zeros(len(values))
    for pattern in np.unique(code):
        own = code == pattern
        there = np.flatnonzero(known[np.argmax(own)])
        off, part = values[own][:, there] - mean[there], covariance[np.ix_(there, there)]
        square = (off @ np.linalg.inv(part) * off).sum(axis=1)
        result[own] = -0.5 * square - 0.5 * np.linalg.slogdet(2 * np.pi * part)[1]
    return result


def radial_classes(values: Floats, weight: Floats) -> tuple[list[tuple[float, Floats, Floats]], Floats]:
    """Barrel, nearly none and pincushion, and a wide class: weight, mean (3,), covariance (3, 3) of each; and the
    weight (N, 4) of each row in each class."""
    low, high = np.nanquantile(values, [0.05, 0.95], axis=0)
    begun = [values[:, 0] < -0.1, np.abs(values[:, 0]) < 0.03, values[:, 0] > 0.03]
    means = [np.nanmedian(values[own], axis=0) for own in begun] + [(low + high) / 2]
    spreads = [np.diag(np.nanvar(values[own], axis=0) / 4 + _LEAST_SPREAD**2) for own in begun]
    spreads.append(np.diag(((high - low) / 2) ** 2))
    share, belongs = np.full(4, 0.25), np.zeros((len(values), 4))
    for _ in range(_ROUNDS):
        log = np.stack([np.log(share[k]) + log_density(values, means[k], spreads[k]) for k in range(4)], axis=1)
        belongs = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None]) * weight[:, None]
        for k in range(3):
            means[k], spreads[k] = _moments(values, belongs[:, k], means[k], spreads[k])
        share = belongs.sum(axis=0) / weight.sum()
    return [(float(share[k]), means[k], spreads[k]) for k in range(4)], belongs


def _moments(values: Floats, weight: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of weighted rows; what is missing stands at its expectation, with its own covariance."""
    filled, missing = np.where(np.isfinite(values), values, 0.0), ~np.isfinite(values)
    more = np.zeros_like(covariance)
    for pattern in np.unique(missing, axis=0):
        if not pattern.any():
            continue
        own = (missing == pattern).all(axis=1)
        gain = covariance[np.ix_(pattern, ~pattern)] @ np.linalg.inv(covariance[np.ix_(~pattern, ~pattern)])
        filled[np.ix_(own, pattern)] = mean[pattern] + (values[own][:, ~pattern] - mean[~pattern]) @ gain.T
        rest = covariance[np.ix_(pattern, pattern)] - gain @ covariance[np.ix_(~pattern, pattern)]
        more[np.ix_(pattern, pattern)] += weight[own].sum() * rest
    mean = weight @ filled / weight.sum()
    off = filled - mean
    floor = _LEAST_SPREAD_ROWS * np.diag(_LEAST_SPREAD**2)
    return mean, ((weight[:, None] * off).T @ off + more + floor) / (weight.sum() + _LEAST_SPREAD_ROWS)


def widths(values: Floats, weight: Floats, components: int) -> list[tuple[float, float]]:
    """Shares and sigmas of the two narrowest of some zero-mean Gaussians; a third is error of calibrations."""
    known: Mask = np.isfinite(values) & (weight > 0)
    values, weight = values[known], weight[known]
    share = np.full(components, 1 / components)
    sigma = np.quantile(np.abs(values), np.linspace(0.3, 0.95, components))
    for _ in range(5 * _ROUNDS):
        log = np.log(share) - 0.5 * (values[:, None] / sigma) ** 2 - np.log(sigma)
        belongs = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None]) * weight[:, None]
        share = belongs.sum(axis=0) / weight.sum()
        sigma = np.sqrt((belongs * values[:, None] ** 2).sum(axis=0) / belongs.sum(axis=0))
    order = np.argsort(sigma)[:2]
    return [(float(share[i] / share[order].sum()), float(sigma[i])) for i in order]


def log_focal(rows: list[dict[str, str]], weight: Floats) -> tuple[float, float]:
    """Mean and sigma of log(focal / larger side)."""
    values = np.log([_number(row, "fx") / _side(row) for row in rows])
    mean = float(np.average(values, weights=weight))
    sigma = float(np.sqrt(np.average((values - mean) ** 2, weights=weight)))
    return mean, sigma


def focals_of(rows: list[dict[str, str]], weight: Floats, bends: Floats) -> tuple[float, float, Floats]:
    """log_focal of a class, and how its terms (N, 3) change with that number, drawn to 0 where rows are few."""
    mean, sigma = log_focal(rows, weight)
    off = np.log([_number(row, "fx") / _side(row) for row in rows]) - mean
    known = np.isfinite(bends)
    centred = np.where(known, bends - np.nansum(weight[:, None] * bends, axis=0) / (weight @ known), 0.0)
    square = (weight * off**2) @ known + _LEAST_SPREAD_ROWS * sigma**2
    return mean, sigma, (weight * off) @ centred / square


def _text(value: object) -> str:
    if isinstance(value, (list, tuple, np.ndarray)):
        inner = ", ".join(_text(one) for one in value)
        return f"({inner},)" if len(value) == 1 else f"({inner})"
    return f"{value:.3g}"


def main() -> None:
    """Read the table of calibrations, write the table of priors."""
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    rows, weight = rows_of(source, "pinhole_k3")
    half = np.array([_half(row) for row in rows])
    terms = np.array([[_number(r, "k1"), _number(r, "k2"), _number(r, "k3", "k3 fixed")] for r in rows])
    radial, belongs = radial_classes(terms * half[:, None] ** [2, 4, 6], weight)
    centre = np.array(
        [
            [(_number(r, f"c{axis}", "pp fixed") - (float(r[size]) - 1) / 2) / _side(r) for r in rows]
            for axis, size in (("x", "width"), ("y", "height"))
        ]
    )
    tangential = np.array([[_number(r, key, "p fixed") for r in rows] for key in ("p1", "p2")])
    aspect = np.array([_number(r, "fy", "fx=fy") / float(r["fx"]) - 1 for r in rows])
    well_made = weight * (np.abs(aspect) < _SQUARE)
    fisheyes, fisheye_weight = rows_of(source, "fisheye")
    bends = np.array([[_number(r, key) for key in ("k1", "k2", "k3", "k4")] for r in fisheyes])
    bends_mean = np.average(bends, axis=0, weights=fisheye_weight)
    bends_sigma = np.sqrt(np.average((bends - bends_mean) ** 2, axis=0, weights=fisheye_weight))
    both = np.concatenate([well_made, well_made])
    tables: dict[str, tuple[object, str]] = {
        "RADIAL": (radial, "Weight, mean and covariance of each class: barrel, nearly none, pincushion, any."),
        "RADIAL_FOCAL": (
            [focals_of(rows, own, terms * half[:, None] ** [2, 4, 6]) for own in belongs.T],
            "FOCAL of each class, and how its radial terms change with that number: long lenses bend less.",
        ),
        "CENTRE": (widths(centre.ravel(), both, 2), "Weight and sigma, of each coordinate, of the larger side."),
        "TANGENTIAL": (widths(tangential.ravel(), both, 2), "Weight and sigma of p1 and p2."),
        "ASPECT": (widths(aspect, weight, 3), "Weight and sigma of the aspect about 1."),
        "FOCAL": (log_focal(rows, weight), "Mean and sigma of log(focal / larger side)."),
        "FISHEYE": ((bends_mean, bends_sigma), "Mean and sigma of k1 to k4 of the equidistant polynomial."),
        "FISHEYE_FOCAL": (log_focal(fisheyes, fisheye_weight), "As FOCAL, of fisheyes."),
    }
    text = _HEAD.format(count=len(rows) + len(fisheyes), repositories=round(weight.sum() + fisheye_weight.sum()))
    for name, (values, said) in tables.items():
        text += f'{name} = {_text(values)}\n"""{said}"""\n\n'
    target.write_text(text.rstrip("\n") + "\n")
    print(text)


if __name__ == "__main__":
    main()

"""What a motion shows of how two groups of cameras stand to each other, that see different parts of one body.

A small twist X of one group goes unseen where it looks the same from every pose a of the body: where Ad(a^-1) X is
one twist on the body. A turn about a fixed axis commutes with turning about that axis, and so does sliding along it;
a motion in a plane commutes with sliding across that. What is left of X in each direction beyond its mean over all
poses is what the motion says of it, and noise of the poses says as much of everything: the two are held against each
other direction by direction (errors in variables: Fuller, "Measurement Error Models", 1987).
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix

# Of what a motion says in a direction, less than this share being real, all may be chance.
REAL = 0.5


@dataclass(frozen=True, eq=False)
class Shown:
    """Twists (6, 6), columns, that move one group of cameras in the frame of the poses, and for each how much (6,) of
    what the motion says of it is no noise, 0 to 1."""

    twists: Floats
    share: Floats

    @property
    def duals(self) -> Floats:
        """Rows (6, 6) that take a twist to its coordinates along these."""
        return np.asarray(np.linalg.inv(self.twists), float)

    @property
    def open(self) -> Floats:
        """An orthonormal basis (6, K) of the twists of which the motion says nothing."""
        return np.asarray(np.linalg.qr(self.twists[:, self.share <= REAL])[0], float)

    def moved(self, b_from_a: Pose) -> "Shown":
        """The same in another frame."""
        return Shown(adjoint(b_from_a) @ self.twists, self.share)


def adjoint(pose: Pose) -> Floats:
    """(..., 6, 6): a_from_b takes twists in frame b to those in frame a."""
    result = np.zeros((*pose.translation.shape[:-1], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = pose.rotation
    result[..., 3:, :3] = cross_matrix(pose.translation) @ pose.rotation
    return result


def shown_by_motion(poses: Pose, covariance: Floats) -> Shown:
    """What poses (F,) of a body in a frame show of small motions in that. covariance (F, 6, 6): of their twists, in
    that frame too."""
    information = np.linalg.inv(covariance)
    on_body = adjoint(poses)
    crossed = (information @ on_body).sum(axis=0)
    of_mean = (np.swapaxes(on_body, -1, -2) @ information @ on_body).sum(axis=0)
    said = information.sum(axis=0) - crossed @ np.linalg.solve(of_mean, crossed.T)
    brackets = _brackets()
    turned = brackets @ covariance[:, None] @ np.swapaxes(brackets, -1, -2)[:, None, None]
    noise = np.einsum("fab,jfiba->ij", information, turned)
    noise = (noise + noise.T) / 2
    # Noise mixes directions: what sliding alone explains is no turn.
    slides, share = _shares(said, noise, np.eye(6)[:, 3:])
    slides, share = slides[:, share <= REAL], share[share <= REAL]
    others = np.linalg.svd(slides.T @ noise)[2][slides.shape[1] :].T
    twists, rest = _shares(said, noise, others)
    return Shown(np.concatenate([slides, twists], axis=1), np.concatenate([share, rest]))


def _shares(said: Floats, noise: Floats, among: Floats) -> tuple[Floats, Floats]:
    """Twists (6, K) among these (6, K), none of which says anything of another, and the shares (K,) of what is said
    of each that are no noise."""
    from scipy.linalg import eigh

    ratio, combined = eigh(among.T @ said @ among, among.T @ noise @ among)
    return among @ combined, 1 - 1 / np.maximum(ratio, 1.0)


def _brackets() -> Floats:
    """ad (6, 6, 6) of the unit twists: [ad[i] @ n] is the bracket of the i-th and n."""
    result = np.zeros((6, 6, 6))
    turns = cross_matrix(np.eye(3))
    result[:3, :3, :3] = result[:3, 3:, 3:] = result[3:, 3:, :3] = turns
    return result

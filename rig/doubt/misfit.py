"""Whether a rig fits its Views at all: its covariance assumes that, and cannot say so."""

import numpy as np

from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats, median
from quadrig.single.posterior.lens_remainder import largest_field

# Corners of which nothing is claimed are known to this, px.
_USUAL_NOISE = 0.3
# Blur, tone curve and what a lens model lacks leave real rigs at up to three times what a detector claims, or at half
# a thousandth of the larger side of large pictures. A wrong lens, size or camera leaves more.
_FAR = 5.0
_FAR_SHARE = 0.001
# Of the Views that can be checked against others; simulated rigs with a tenth of them wrong reject a fifth at most.
_MOST_REJECTED = 0.5


def noise_limit(rig: Rig) -> float:
    """Residual (px, root mean square of a coordinate) from which its Views do not fit."""
    claimed: Floats = np.array([fit.view.sigma for fit in rig.fits])
    claimed = claimed[np.isfinite(claimed)]
    sigma = max(median(claimed) if len(claimed) else 0.0, _USUAL_NOISE)
    side = max(max(one.intrinsics.width, one.intrinsics.height) for one in rig.cameras)
    return max(_FAR * sigma, _FAR_SHARE * side)


def misses(rig: Rig) -> bool:
    """Whether the Views miss the rig by far more than corners are unsure."""
    return bool(np.isfinite(rig.rms) and rig.rms > np.sqrt(2) * noise_limit(rig))


def misfits(rig: Rig) -> tuple[str, ...]:
    """In words: that the Views miss the rig by far more than corners are known to, that most were rejected, or that
    they fit only by what no lens leaves beside its model."""
    sentences = [
        f"{camera.name}: its Views fit only with {camera.remainder:.1f} px beside its lens model, more than any lens "
        "leaves: its focal and sigmas are not to be believed; look whether a lens that was given is this camera's, "
        "and show flat rectangles, tilted by 30 degrees to all sides"
        for camera in rig.cameras
        if camera.remainder > largest_field(camera.intrinsics.width)
    ]
    if misses(rig):
        worst = max(rig.cameras, key=lambda camera: np.nan_to_num(camera.rms))
        sentences.append(
            f"Views miss the rig by {rig.rms:.1f} px ({worst.name} by {worst.rms:.1f} px), far more than corners are "
            "unsure: a lens or a size that was given is wrong, or something moved; check what rig.toml says of them"
        )
    rejected = sum(bool(fit.rejected) for fit in rig.fits)
    if rejected > _MOST_REJECTED * len(rig.fits):
        together = "that all cameras saw them at the same time, " if len(rig.cameras) > 1 else ""
        sentences.append(
            f"most Views were rejected, {rejected} of {len(rig.fits)}: what is left may agree by chance; check names "
            f"and sizes of the rectangles, {together}and that what rig.toml has standing still did, and the camera"
        )
    return tuple(sentences)

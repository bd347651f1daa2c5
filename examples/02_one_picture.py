"""One picture of one sheet: the camera's focal and pose, and how sure they are.

    python examples/02_one_picture.py

Here the picture is rendered, so that the truth is known; with a photograph cv2.imread takes the renderer's place.
"""

import numpy as np

from quadrig.single import (
    Capture,
    Intrinsics,
    Pose,
    Rectangle,
    Sheet,
    TagMarking,
    calibrate_view,
    detect_views,
    render_image,
)


def main() -> None:
    """Print focal and distance beside the truth."""
    tag = Rectangle("desk", 0.16, 0.16, TagMarking("apriltag_36h11", 7))
    lens = Intrinsics.centred(1280, 720, 900.0)
    camera_from_rect = Pose.from_vectors(np.array([0.7, 0.3, 0.1]), np.array([0.02, -0.01, 0.45]))
    capture = Capture(blur=0.6, noise=1.5)
    picture = render_image(lens, camera_from_rect, [Sheet(tag, Pose.identity())], capture=capture)

    (view,) = detect_views(picture, [tag])
    found = calibrate_view(view, (1280, 720), principal_point=lens.principal_point, distortion="none")

    distance_sigma = np.sqrt(found.pose_covariance[0, 5, 5])
    distance = found.camera_from_rects.translation[0, 2]
    print(f"focal {found.intrinsics.focal:.1f} +- {found.focal_sigma:.1f} px, truth {lens.focal:.1f}")
    print(f"distance {1e3 * distance:.1f} +- {1e3 * distance_sigma:.1f} mm, truth 450.0")


if __name__ == "__main__":
    main()

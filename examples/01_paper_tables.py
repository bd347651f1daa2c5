"""The paper's Tables 2 to 6, printed beside what quadrig gets.

    python examples/01_paper_tables.py [--runs 1000] [--zhang ../shared/data/zhang]

"Four points: one-pass geometrical camera calibration algorithm". Tables 2, 3 and 4 need nothing but this script;
Tables 5 and 6 need the Microsoft Camera Calibration data set and are left out where it is not to be found.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from quadrig.single import (
    Capture,
    ChessboardMarking,
    Intrinsics,
    Pose,
    Rectangle,
    Sheet,
    View,
    angles_from_rotation,
    calibrate_view,
    closed_form,
    cramer_rao,
    detect_views,
    paper_form,
    paper_sigmas,
    rectangle_corners,
    render_image,
    rotation_from_angles,
    solve_points,
)
from quadrig.single.solve.cramer_rao import MEAN_ABSOLUTE

ROWS = ("T_X", "T_Y", "T_Z", "theta_x", "theta_y", "theta_z", "f")

# Table 2 as printed: for each noise 1 to 6 px, the columns [22], "our method", [7] of T (m), theta (degrees), f (px).
PRINTED_TABLE_2 = np.array(
    [
        [[0.0121, 0.0193, 0.0097], [0.0942, 0.0022, 0.0110], [0.1592, 0.0131, 0.0079], [4.1646, 0.1207, 0.1310],
         [2.3324, 0.1290, 0.1362], [5.5240, 0.1545, 0.1955], [279, 7.789, 6.690]],
        [[0.0268, 0.0381, 0.0209], [0.2646, 0.0043, 0.0235], [0.3816, 0.0251, 0.0162], [8.50, 0.2405, 0.2766],
         [7.84, 0.2549, 0.2827], [13.35, 0.2999, 0.4124], [1052, 15.31, 14.30]],
        [[0.055, 0.0571, 0.0375], [0.6678, 0.0065, 0.0365], [0.7408, 0.0376, 0.0243], [13.2, 0.3604, 0.4870],
         [17.07, 0.3813, 0.4830], [25.21, 0.4352, 0.7225], [1885, 22.89, 24.52]],
        [[0.055, 0.0770, 0.0375], [0.6678, 0.0084, 0.0365], [0.7408, 0.0499, 0.0243], [13.2, 0.4856, 0.4870],
         [17.07, 0.5113, 0.4830], [25.21, 0.5836, 0.7225], [2422, 30.11, 39.80]],
        [[0.0763, 0.0975, 0.0876], [1.1411, 0.0105, 0.0718], [1.617, 0.0645, 0.0442], [21.77, 0.5950, 1.1067],
         [26.53, 0.6271, 1.0492], [38.94, 0.7314, 1.6521], [2509, 39.15, 59.66]],
        [[0.0861, 0.1141, 0.1255], [1.9292, 0.0122, 0.0947], [2.3948, 0.0758, 0.0520], [24.43, 0.6891, 1.5057],
         [27.61, 0.7187, 1.4092], [41.63, 0.8936, 2.2983], [3024, 45.69, 81.86]],
    ]
)  # fmt: skip

FOCAL, CENTRE, SIDE = 1700.0, np.array([500.0, 500.0]), 0.70
ANGLES = np.radians([25.0, 35.0, 45.0])
PRINTED_T, VISIBLE_T = np.array([0.2, 3.4, 1.8]), np.array([-2.2, 1.33, -2.86])
# The four corners of Eq. 4 among the 8x8 points, which run row by row from (-, -).
OUTER = [63, 56, 0, 7]


def grid() -> np.ndarray:
    """The 8x8 points (64, 3) of the 70 x 70 cm object, metres."""
    steps = np.linspace(-SIDE / 2, SIDE / 2, 8)
    y, x = np.meshgrid(steps, steps, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.zeros(64)], axis=-1)


def image_of(camera_from_rect: Pose, points: np.ndarray) -> np.ndarray:
    """Eq. 6, without asking whether a point lies in front of the camera."""
    located = camera_from_rect.transform(points)
    return FOCAL * located[..., :2] / located[..., 2:] + CENTRE


@dataclass(frozen=True)
class Errors:
    """What one method did: errors (runs, 7) of T (m), theta (degrees), f (px), and its time for a run, seconds."""

    errors: np.ndarray
    seconds: float

    @property
    def mean(self) -> np.ndarray:
        return np.nanmean(np.abs(self.errors), axis=0) if np.isfinite(self.errors).any() else np.full(7, np.nan)

    @property
    def failed(self) -> int:
        return int((~np.isfinite(self.errors).all(axis=1)).sum())


def errors_of(rect_from_camera: Pose, focal: np.ndarray, truth: Pose, seconds: float) -> Errors:
    """Errors against the truth. Of two poses that a formal projection cannot distinguish (every point's depth changes
    its sign) the one on the truth's side of the sheet counts."""
    rotation, T = rect_from_camera.rotation, rect_from_camera.translation
    other_side = T[..., 2] * truth.translation[2] < 0
    # camera_from_rect with its x and y axes and its translation negated: the sheet turned about its own normal.
    turned = np.diag([-1.0, -1.0, 1.0]) @ rotation
    flipped = np.diag([1.0, 1.0, -1.0]) @ T[..., None]
    rotation = np.where(other_side[..., None, None], turned, rotation)
    T = np.where(other_side[..., None], flipped[..., 0], T)
    found = np.stack(angles_from_rotation(rotation), axis=-1) - np.stack(
        angles_from_rotation(truth.rotation), axis=-1
    )
    angles = np.degrees(np.remainder(found + np.pi, 2 * np.pi) - np.pi)
    return Errors(np.concatenate([T - truth.translation, angles, (focal - FOCAL)[..., None]], axis=-1), seconds)


def five_points(pixels: np.ndarray) -> tuple[np.ndarray, Pose]:
    """Focal (N) and rect_from_camera from five points on two orthogonal 1-D objects that share one, as [22] has them.

    pixels (N, 5, 2): the shared corner (-, -), then 35 and 70 cm along x, 35 and 70 cm along y. Written from the
    description in the paper: three points with known lengths give each object's direction and depths, two orthogonal
    directions of known length the focal.
    """
    rays = np.concatenate([pixels - CENTRE, np.ones((*pixels.shape[:-1], 1))], axis=-1)
    start, directions = rays[:, 0], []
    for middle, end in ((rays[:, 1], rays[:, 2]), (rays[:, 3], rays[:, 4])):
        # depth_end end - start = 2 (depth_middle middle - start), the depth of the shared point being one.
        columns = np.stack([end, -2 * middle], axis=-1)
        depths = (np.linalg.pinv(columns) @ -start[..., None])[..., 0]
        directions.append((depths[:, :1] * end - start) / SIDE)
    a, b = directions
    p = np.stack([a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1], ((a**2 - b**2)[:, :2]).sum(axis=1) / 2])
    q = np.stack([a[:, 2] * b[:, 2], (a[:, 2] ** 2 - b[:, 2] ** 2) / 2])
    with np.errstate(invalid="ignore"):
        focal = 1 / np.sqrt(-(p * q).sum(axis=0) / (p * p).sum(axis=0))
    scale = np.stack([1 / focal, 1 / focal, np.ones_like(focal)], axis=-1)
    u, _, vt = np.linalg.svd(np.stack([a * scale, b * scale], axis=-1)[np.isfinite(focal)], full_matrices=False)
    rotation, translation = np.full((len(focal), 3, 3), np.nan), np.full((len(focal), 3), np.nan)
    columns = u @ vt
    rotation[np.isfinite(focal)] = np.concatenate(
        [columns, np.cross(columns[..., 0], columns[..., 1])[..., None]], axis=-1
    )
    size = (np.linalg.norm(a * scale, axis=1) + np.linalg.norm(b * scale, axis=1)) / 2
    corner = np.array([-SIDE / 2, -SIDE / 2, 0.0])
    translation = start * scale / size[:, None] - rotation @ corner
    return focal, Pose(rotation, translation).inverse()


def zhang(views: list[np.ndarray]) -> tuple[np.ndarray, Pose]:
    """Focal (N) and rect_from_camera of the first of three views (N, 64, 2) by OpenCV's implementation of [7], given
    what the others know: the principal point, square pixels, no distortion."""
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    )  # fmt: skip
    points = [grid().astype(np.float32)] * len(views)
    runs = len(views[0])
    focal, rotation, translation = np.full(runs, np.nan), np.full((runs, 3, 3), np.nan), np.full((runs, 3), np.nan)
    for i in range(runs):
        guess = np.array([[1000.0, 0, CENTRE[0]], [0, 1000.0, CENTRE[1]], [0, 0, 1]])
        try:
            _, K, _, turns, shifts = cv2.calibrateCamera(
                points, [view[i].astype(np.float32) for view in views], (1000, 1000), guess, None, flags=flags
            )
        except cv2.error:
            continue
        focal[i], rotation[i], translation[i] = K[0, 0], cv2.Rodrigues(turns[0])[0], shifts[0].ravel()
    return focal, Pose(rotation, translation).inverse()


def table_2(
    T: np.ndarray, noise: float, runs: int, rng: np.random.Generator, *, photographed: bool
) -> dict[str, Errors]:
    """Every method on the same noisy points."""
    truth = Pose(rotation_from_angles(*ANGLES), T)
    points, camera_from_rect = grid(), truth.inverse()
    exact = image_of(camera_from_rect, points)
    noisy = exact + rng.normal(0, noise, (runs, 64, 2))
    corner = np.array([-SIDE / 2, -SIDE / 2, 0.0])
    along = np.array([[0, 0, 0], [0.35, 0, 0], [0.70, 0, 0], [0, 0.35, 0], [0, 0.70, 0]])
    five = image_of(camera_from_rect, along + corner) + rng.normal(0, noise, (runs, 5, 2))
    others = []
    for turned in ((-20.0, 35.0, 40.0), (30.0, -30.0, 50.0)):
        rotation = rotation_from_angles(*np.radians(turned))
        pose = Pose(rotation, -3.8 * rotation[:, 2]).inverse()
        others.append(image_of(pose, points) + rng.normal(0, noise, (runs, 64, 2)))

    # OpenCV needs 5 ms a run, and 90 where a formal projection leads it astray: fewer runs show the same.
    most = 100 if photographed else 10

    def run(method) -> Errors:
        begin = time.perf_counter()
        focal, rect_from_camera = method()
        return errors_of(rect_from_camera, np.asarray(focal), truth, (time.perf_counter() - begin) / len(focal))

    def four_by_paper():
        answer = paper_form(noisy[:, OUTER], SIDE, SIDE, CENTRE, photographed)
        return answer.focal, answer.rect_from_camera

    def four_in_closed_form():
        answer = closed_form(noisy[:, OUTER], SIDE, SIDE, CENTRE, sigma=noise, photographed=photographed)
        return answer.focal, answer.camera_from_rect.inverse()

    def four_corners():
        answer = solve_points(points[OUTER], noisy[:, OUTER], CENTRE, sigma=noise, photographed=photographed)
        return answer.focal, answer.rect_from_camera

    def all_by_homography():
        corners = corners_of_homography(noisy)
        answer = paper_form(corners, SIDE, SIDE, CENTRE, photographed)
        return answer.focal, answer.rect_from_camera

    def all_points():
        answer = solve_points(points, noisy, CENTRE, sigma=noise, photographed=photographed)
        return answer.focal, answer.rect_from_camera

    return {
        "[22] five points": run(lambda: five_points(five)),
        "[7] three views": run(lambda: zhang([view[:most] for view in (noisy, *others)])),
        "paper, 4 corners": run(four_by_paper),
        "ours, 4 closed": run(four_in_closed_form),
        "ours, 4 corners": run(four_corners),
        "paper, 64 by H": run(all_by_homography),
        "ours, 64 points": run(all_points),
    }


def corners_of_homography(pixels: np.ndarray) -> np.ndarray:
    """Where the homography of all 8x8 points (N, 64, 2) has the four corners (N, 4, 2)."""
    from quadrig.single.solve.homography import homographies

    H = homographies(grid()[:, :2], pixels)
    corners = rectangle_corners(SIDE, SIDE)[:, :2]
    mapped = corners @ np.swapaxes(H[..., :2], -1, -2) + H[..., None, :, 2]
    return mapped[..., :2] / mapped[..., 2:]


def bound(T: np.ndarray, points: np.ndarray, noise: float) -> np.ndarray:
    """Cramer-Rao bound on the mean absolute errors (7), in the table's units."""
    pose = Pose(rotation_from_angles(*ANGLES), T).inverse()
    sigmas = paper_sigmas(cramer_rao(points, FOCAL, pose, CENTRE, noise), pose)
    sigmas[3:6] = np.degrees(sigmas[3:6])
    return MEAN_ABSOLUTE * sigmas


def print_table_2(runs: int) -> None:
    rng = np.random.default_rng(2)
    for title, T, photographed in (
        ("at Table 1's printed pose, T = (0.2, 3.4, 1.8) m, which no camera can photograph", PRINTED_T, False),
        ("at a pose that can be photographed, T = (-2.2, 1.33, -2.86) m", VISIBLE_T, True),
    ):
        for level, printed in enumerate(PRINTED_TABLE_2):
            noise = float(level + 1)
            methods = table_2(T, noise, runs, rng, photographed=photographed)
            limits = bound(T, grid()[OUTER], noise), bound(T, grid(), noise)
            print(f"\nTable 2 {title}; noise {noise:.0f} px, {runs} runs, mean absolute error (m, degrees, px)")
            names = ["printed [22]", "printed ours", "printed [7]", *methods, "bound, 4", "bound, 64"]
            print(f"{'':8}" + "".join(f"{name:>18}" for name in names) + f"{'printed/64 points':>20}")
            for row, label in enumerate(ROWS):
                cells = [*printed[row], *(m.mean[row] for m in methods.values()), limits[0][row], limits[1][row]]
                ratio = printed[row, 1] / methods["ours, 64 points"].mean[row]
                print(f"{label:8}" + "".join(f"{cell:18.4g}" for cell in cells) + f"{ratio:19.1f}x")
            times = "".join(f"{1e3 * m.seconds:18.4f}" for m in methods.values())
            print(f"{'ms a run':8}{'':54}{times}")
            if any(m.failed for m in methods.values()):
                print(f"{'failed':8}{'':54}" + "".join(f"{m.failed:18d}" for m in methods.values()))


# Tables 3 and 4: T in cm, theta in degrees, f; the columns are the truth and the paper's "our method".
PRINTED_TABLE_3 = np.array(
    [[75, 75.24], [-75, -74.89], [-75, -75.05], [-45, -44.93], [-35, -35.01], [0, 0.009], [4830, 4823]]
)
PRINTED_TABLE_4 = np.array(
    [[75, 74.90], [-75, -74.87], [-75, -74.90], [-41, -40.97], [-32.35, -32.32], [28.29, 28.29], [4830, 4816]]
)
BOARD = Rectangle("board", 0.30, 0.40, ChessboardMarking(9, 12, 0.40 / 12))


def rendered(truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a rendered picture of the 30 x 40 cm board gives for (T cm, theta degrees, f), and its sigmas."""
    rect_from_camera = Pose(rotation_from_angles(*np.radians(truth[3:6])), truth[:3] / 100)
    lens, sheet = Intrinsics.centred(2300, 1800, truth[6]), Sheet(BOARD, Pose.identity())
    picture = render_image(lens, rect_from_camera.inverse(), [sheet], capture=Capture(blur=0.5))
    (view,) = detect_views(picture, [BOARD])
    found = calibrate_view(view, (2300, 1800), principal_point=lens.principal_point, distortion="none")
    pose = found.rect_from_cameras[0]
    sigmas = paper_sigmas(found.covariance(), found.camera_from_rects[0])
    values = np.array(
        [*100 * pose.translation, *np.degrees(angles_from_rotation(pose.rotation)), found.intrinsics.focal]
    )
    return values, sigmas * np.array([100, 100, 100, *np.degrees(np.ones(3)), 1])


def print_tables_3_and_4() -> None:
    for number, printed in ((3, PRINTED_TABLE_3), (4, PRINTED_TABLE_4)):
        values, sigmas = rendered(printed[:, 0])
        print(f"\nTable {number}: rendered 30 x 40 cm board, T in cm, theta in degrees, f in px")
        print(f"{'':8}{'truth':>10}{'printed':>10}{'error':>10}{'quadrig':>12}{'sigma':>10}{'error':>10}")
        for label, (truth, paper), value, sigma in zip(ROWS, printed, values, sigmas, strict=True):
            relative = label.startswith(("T", "f"))
            paper_error, error = (
                f"{100 * abs(x / truth - 1):.3f} %" if relative else f"{abs(x - truth):.4f}" for x in (paper, value)
            )
            print(f"{label:8}{truth:10.2f}{paper:10.2f}{paper_error:>10}{value:12.4f}{sigma:10.4f}{error:>10}")


INCH = 0.0254
# The paper's column "our method", for views 1 and 3.
PRINTED_TABLE_5_6 = {
    1: np.array([-3.58, 3.52, 12.28, 0.91, 6.90, -5.94, 784.3]),
    3: np.array([-2.51, 3.69, 14.07, -0.28, 23.79, -6.35, 865.2]),
}
ZHANG_OUTER = [30, 3, 224, 253]


def print_tables_5_and_6(folder: Path) -> None:
    model = np.loadtxt(folder / "Model.txt").reshape(-1, 2) * INCH
    # Both the model's y and the pictures' v run upwards, so the rectangle's axes are the model's.
    middle = np.array([*(model.min(axis=0) + model.max(axis=0)) / 2, 0.0])
    points = np.concatenate([model, np.zeros((len(model), 1))], axis=1) - middle
    text = (folder / "completecalibration.txt").read_text().split()
    numbers = np.array([float(word) for word in text])
    truth_focal, centre = numbers[0], numbers[3:5]
    for number in range(1, 6):
        rows = numbers[7 + 12 * (number - 1) : 19 + 12 * (number - 1)]
        truth = np.array([*rows[9:12], *zhang_angles(rows[:9].reshape(3, 3)), truth_focal])
        pixels = np.loadtxt(folder / f"data{number}.txt").reshape(-1, 2)
        results = []
        for chosen in (slice(None), ZHANG_OUTER):
            view = View("board", points[chosen], pixels[chosen], sigma=0.2)
            found = calibrate_view(view, (640, 480), principal_point=centre)
            t = found.camera_from_rects[0].transform(-middle) / INCH
            angles = zhang_angles(found.camera_from_rects[0].rotation)
            results.append((np.array([*t, *angles, found.intrinsics.focal]), found.focal_sigma))
        table = {1: "Table 5, ", 3: "Table 6, "}.get(number, "")
        print(f"\n{table}view {number} of the Microsoft data set, alone: T in inches, theta in degrees, f in px")
        print(f"{'':8}{'truth':>10}{'printed':>10}{'256 corners':>14}{'4 corners':>12}")
        printed = PRINTED_TABLE_5_6.get(number)
        for row, label in enumerate(ROWS):
            paper = "" if printed is None else f"{printed[row]:.2f}"
            print(f"{label:8}{truth[row]:10.2f}{paper:>10}{results[0][0][row]:14.2f}{results[1][0][row]:12.2f}")
        print(f"{'sigma f':8}{'':20}{results[0][1]:14.2f}{results[1][1]:12.2f}")
        paper = "" if printed is None else f"{100 * abs(printed[6] / truth_focal - 1):.2f} %"
        errors = [100 * abs(values[6] / truth_focal - 1) for values, _ in results]
        print(f"{'error f':8}{'':10}{paper:>10}{errors[0]:12.2f} %{errors[1]:10.2f} %")


def zhang_angles(rotation: np.ndarray) -> np.ndarray:
    """The angles of Tables 5 and 6, degrees: those of R = Rz Ry Rx, with the labels of x and z exchanged."""
    about_x = np.arctan2(rotation[2, 1], rotation[2, 2])
    about_y = np.arcsin(-rotation[2, 0])
    about_z = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.degrees([about_z, about_y, about_x])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="runs for each noise of Table 2")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "zhang"
    parser.add_argument("--zhang", type=Path, default=beside, help="folder of the Microsoft data set")
    asked = parser.parse_args()
    print_table_2(asked.runs)
    print_tables_3_and_4()
    if (asked.zhang / "Model.txt").is_file():
        print_tables_5_and_6(asked.zhang)
    else:
        print(f"\nTables 5 and 6 are left out: there is no data set in {asked.zhang}")


if __name__ == "__main__":
    main()

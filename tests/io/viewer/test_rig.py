"""A rig in rerun: the file is read back and says what the Rig says."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadrig.io.commands.inspect import save_rrd
from quadrig.io.drawing.geometry import apart, ellipsoid, first_eye, level_axes, magnification, up_direction
from quadrig.io.drawing.rig_figures import (
    arrow_scale,
    edge_widths,
    graph_edges,
    longest_usual,
    residual_arrows,
    residual_histogram,
)
from quadrig.io.rig_file.rig_mcap import RigFile
from quadrig.rig.doubt.disagreement import disagreements
from quadrig.rig.doubt.residual_field import residual_field
from quadrig.rig.doubt.verdict import verdict
from quadrig.single.pose import Pose

TIMES = tuple(5_000_000_000 + 33_000_000 * index for index in range(12))


@pytest.fixture(scope="module")
def rrd(example_rig, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "rig.rrd"
    save_rrd(path, RigFile(example_rig, "", TIMES, ""), [])
    return path


def held_in(path):
    """Values of each component of each entity of an .rrd, by frameset where they have one."""
    from rerun.chunk import RrdReader

    held: dict[tuple[str, str], list] = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        times = batch.column("frameset").to_pylist() if "frameset" in batch.schema.names else [None] * batch.num_rows
        for name in batch.schema.names:
            if ":" in name:
                values = batch.column(name).to_pylist()
                pairs = [(t, v) for t, v in zip(times, values, strict=True) if v is not None]
                held.setdefault((str(chunk.entity_path), name), []).extend(pairs)
    return held


@pytest.fixture(scope="module")
def logged(rrd) -> dict[tuple[str, str], list]:
    return held_in(rrd)


def test_rerun_accepts_the_file(rrd):
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(rrd)], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_cameras_stand_where_the_rig_has_them(logged, example_rig):
    for camera in example_rig.cameras:
        path = f"/space/cameras/{camera.name}"
        [(_, translation)] = logged[path, "Transform3D:translation"]
        [(_, rotation)] = logged[path, "Transform3D:mat3x3"]
        [(_, projection)] = logged[path, "Pinhole:image_from_camera"]
        # rerun keeps float32, and matrices column by column.
        np.testing.assert_allclose(translation[0], camera.rig_from_camera.translation, atol=1e-6)
        np.testing.assert_allclose(np.reshape(rotation[0], (3, 3)).T, camera.rig_from_camera.rotation, atol=1e-6)
        matrix = np.reshape(projection[0], (3, 3)).T
        np.testing.assert_allclose(matrix, camera.intrinsics.camera_matrix, rtol=1e-6)


def test_rectangles_lie_where_the_rig_has_them(logged, example_rig):
    for placed in example_rig.rectangles:
        strips = logged[f"/space/rectangles/{placed.name}", "LineStrips3D:strips"]
        poses = placed.rig_from_rect if placed.rectangle.moving else placed.rig_from_rect[None]
        assert [time for time, _ in strips] == (placed.framesets.tolist() if placed.rectangle.moving else [None])
        for row, (_, strip) in enumerate(strips):
            corners = poses[row].transform(placed.rectangle.corners)
            np.testing.assert_allclose(strip[0][:4], corners, atol=1e-6)


def test_pictures_hold_what_was_found_and_what_is_missed(logged, example_rig):
    camera = example_rig.cameras[1]
    scale = arrow_scale(example_rig)
    found = logged[f"/space/cameras/{camera.name}/marks/found", "Points2D:positions"]
    arrows = dict(logged[f"/space/cameras/{camera.name}/marks/residuals", "Arrows2D:vectors"])
    for frameset, positions in found:
        own = [f for f in example_rig.fits if (f.view.camera, f.view.frameset) == (camera.name, frameset)]
        np.testing.assert_allclose(positions, np.concatenate([f.view.pixels for f in own]), atol=1e-3)
        residuals = np.concatenate([f.residuals for f in own])
        np.testing.assert_allclose(arrows[frameset], scale * residuals, rtol=1e-5, atol=1e-3)
    assert len(found) == len({f.view.frameset for f in example_rig.fits if f.view.camera == camera.name})


def test_the_verdict_is_there_in_words(logged, example_rig):
    [(_, text)] = logged["/verdict", "TextDocument:text"]
    assert verdict(example_rig).headline in text[0]
    for sentence in (*example_rig.weak, *example_rig.missing.values()):
        assert sentence in text[0]


def test_every_camera_has_its_field_and_histogram(logged, example_rig):
    fields = {camera.name: residual_field(example_rig, camera.name) for camera in example_rig.cameras}
    for camera in example_rig.cameras:
        field = fields[camera.name]
        counts, edges = residual_histogram(field, longest_usual(fields.values()))
        assert counts.sum() == len(field.residuals) > 0
        assert edges[0] == 0
        assert (f"/histogram/{camera.name}", "BarChart:values") in logged
        assert (f"/field/{camera.name}/coverage", "EncodedImage:blob") in logged


def test_edges_are_thicker_the_more_they_carry(example_rig):
    edges = graph_edges(disagreements(example_rig))
    widths = edge_widths([edge.information for edge in edges])
    order = np.argsort([edge.information for edge in edges])
    assert np.all(np.diff(np.array(widths)[order]) >= 0)
    assert max(widths) == 5
    # Views of a rig that fits its truth are near one sigma.
    assert all(edge.sigmas < 3 for edge in edges)


def test_names_lie_apart_from_where_one_looks_first(example_rig):
    eye = first_eye(example_rig)
    anchors = np.array([[0.0, 0, 2.0], [0.01, 0, 2.0], [0.0, 0.01, 2.0], [3.0, 0, 2.0]])
    places = apart(eye, ["one", "two", "three", "far"], anchors)
    np.testing.assert_array_equal(places[[0, 3]], anchors[[0, 3]])
    heights = np.sort(eye.look(places[:3])[:, 1])
    assert np.all(np.diff(heights) > 0.04)


def test_up_is_where_the_pictures_have_it(example_rig):
    assert up_direction(example_rig) @ [0, -1, 0] > 0.9  # cameras are upright, y down
    axes = level_axes(example_rig)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_ellipsoids_are_the_covariance(example_rig):
    covariance = example_rig.pose_covariance("cam2")[3:, 3:]
    sizes, axes = ellipsoid(covariance)
    np.testing.assert_allclose(axes @ np.diag(sizes**2) @ axes.T, covariance, atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert magnification(example_rig) >= 1


def test_arrows_of_faults_do_not_lie_across_everything(example_rig):
    camera = example_rig.cameras[0]
    arrows = residual_arrows(camera, np.array([[0.1, 0.0], [300.0, -400.0], [0.0, 0.0]]), 10.0)
    np.testing.assert_allclose(arrows[0], [1.0, 0.0])
    assert np.linalg.norm(arrows[1]) < 0.2 * camera.intrinsics.width
    np.testing.assert_allclose(arrows[1] / np.linalg.norm(arrows[1]), [0.6, -0.8])
    np.testing.assert_array_equal(arrows[2], 0)


def test_a_room_stands_and_the_rig_goes_its_way(carried_rig, tmp_path):
    save_rrd(tmp_path / "room.rrd", RigFile(carried_rig), [])
    held, (hall,) = held_in(tmp_path / "room.rrd"), carried_rig.bodies
    [(_, rings)] = held["/room/rectangles", "LineStrips3D:strips"]
    for ring, placed, pose in zip(rings, carried_rig.rectangles, range(4), strict=True):
        np.testing.assert_allclose(ring[:4], hall.body_from_rect[pose].transform(placed.rectangle.corners), atol=1e-6)
    places = held["/room/rig", "Transform3D:translation"]
    assert [time for time, _ in places] == hall.framesets.tolist()
    np.testing.assert_allclose([at[0] for _, at in places], hall.path()[0].translation, atol=1e-6)
    [(_, path)] = held["/room/path", "LineStrips3D:strips"]
    np.testing.assert_allclose(path[0], hall.path()[0].translation, atol=1e-6)
    assert not [entity for entity, _ in held if entity.startswith("/space/rectangles")]


def test_a_body_is_drawn_as_one_thing(carried_rig, tmp_path):
    (hall,) = carried_rig.bodies
    turned = hall.body_from_rect @ Pose.from_vectors(np.array([0.0, np.pi, 0.0]), np.zeros(3))
    box = replace(carried_rig, bodies=(replace(hall, name="box", body_from_rect=turned),))
    save_rrd(tmp_path / "box.rrd", RigFile(box), [])
    held = held_in(tmp_path / "box.rrd")
    assert {entity for entity, _ in held if entity.startswith("/space/rectangles")} == {
        "/space/rectangles/box",
        "/space/rectangles/box/faces",
    }
    strips = held["/space/rectangles/box", "LineStrips3D:strips"]
    assert [len(rings) for _, rings in strips] == [4] * 12

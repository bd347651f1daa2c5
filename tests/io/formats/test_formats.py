"""Exports, each read by the program it is for or by that program's rules, project points as our rig does."""

import json
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from quadrig.io.formats.format import Options, plain_names
from quadrig.io.formats.maps import ideal_rig, undistortion_map
from quadrig.io.formats.registry import FORMATS, export_files, export_rig
from quadrig.io.formats.rig_json import json_schema, json_text, read_json, rig_values
from quadrig.io.formats.ros import from_roll_pitch_yaw, roll_pitch_yaw
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

POINTS = np.array([[0.1, 0.2, 1.9], [-0.3, 0.1, 2.2], [0.2, -0.2, 2.0]])
TURNED = Pose.from_vectors(np.array([0.2, -0.1, 0.3]), np.array([0.4, 0.1, -0.2]))


def predicted(camera):
    return camera.intrinsics.project(camera.rig_from_camera.inverse().transform(POINTS))


def opencv_pixels(in_camera, matrix, distortion, fisheye=False):
    """Pixels by OpenCV's own projection."""
    zero, matrix, distortion = np.zeros(3), np.asarray(matrix, float), np.asarray(distortion, float)
    if fisheye:
        return cv2.fisheye.projectPoints(in_camera[:, None], zero, zero, matrix, distortion)[0][:, 0]
    return cv2.projectPoints(in_camera, zero, zero, matrix, distortion)[0][:, 0]


def assert_pixels(found, camera, tolerance=1e-6):
    np.testing.assert_allclose(found, predicted(camera), rtol=0, atol=tolerance)


def homogeneous(matrix, points):
    matrix = np.asarray(matrix, float)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.fixture(params=["pinhole", "fisheye"])
def rig(request, example_rig) -> Rig:
    """The example, its frame in no camera, through lenses with every coefficient that pinholes and fisheyes have."""
    bent = {"pinhole": [-0.1, 0.02, 1e-3, -2e-3, 0.01], "fisheye": [0.05, -0.02, 0.01, -0.003, 0.0]}[request.param]
    cameras = []
    for camera in example_rig.cameras:
        lens = replace(camera.intrinsics, model=request.param, distortion=np.array(bent), aspect=1.002)
        cameras.append(replace(camera, intrinsics=lens, rig_from_camera=TURNED @ camera.rig_from_camera))
    return replace(example_rig, cameras=tuple(cameras), reference="desk")


@pytest.fixture
def pinholes(example_rig) -> Rig:
    """The example with principal points off the middle, as undistorted pictures show it."""
    cameras = [replace(one, rig_from_camera=TURNED @ one.rig_from_camera) for one in example_rig.cameras]
    centres = [one.intrinsics.principal_point + np.array([30.0, -20.0]) for one in cameras]
    moved = [
        replace(one, intrinsics=replace(one.intrinsics, principal_point=centre))
        for one, centre in zip(cameras, centres, strict=True)
    ]
    return ideal_rig(replace(example_rig, cameras=tuple(moved)))


def is_fisheye(rig: Rig) -> bool:
    return rig.cameras[0].intrinsics.model == "fisheye"


def written(folder, rig, name, options=None):
    """The paths of a rig's files."""
    for file, content in export_files(rig, name, options).items():
        (folder / file).write_bytes(content.encode() if isinstance(content, str) else content)
    return sorted(folder.iterdir())


def test_json_keeps_the_contract(rig):
    values = json.loads(export_files(rig, "json")["rig.json"])
    assert {"rig_frame", "cameras", "lens_only", "working_accuracy_mm", "rectangles"} < set(values)
    assert (values["format"], values["version"], values["rig_frame"]) == ("quadrig rig", 1, "desk")
    assert values["working_accuracy_mm"] == pytest.approx(1e3 * rig.working_accuracy)
    for camera in rig.cameras:
        held = values["cameras"][camera.name]
        keys = ["width", "height", "model", "camera_matrix", "distortion", "rig_from_camera", "sigma", "rms_px"]
        keys += ["clock_offset_s", "line_time_s"]
        assert list(held) == keys
        in_camera = homogeneous(np.linalg.inv(held["rig_from_camera"]), POINTS)
        distortion = held["distortion"][:4] if is_fisheye(rig) else held["distortion"]
        assert_pixels(opencv_pixels(in_camera, held["camera_matrix"], distortion, is_fisheye(rig)), camera)
        assert held["sigma"]["position_m"] == pytest.approx(rig.position_sigma(camera.name))
        assert held["sigma"]["lens"]["focal"] == held["sigma"]["focal_px"] == rig.focal_sigma(camera.name)
        names = ["k1", "k2", "k3", "k4"] if is_fisheye(rig) else ["k1", "k2", "p1", "p2", "k3"]
        assert [name for name in held["sigma"]["lens"] if name[0] in "kp"] == names
    assert np.shape(values["rectangles"]["desk"]["rig_from_rect"]) == (4, 4)
    assert np.shape(values["rectangles"]["board"]["rig_from_rect"]) == (12, 4, 4)


def test_json_follows_its_schema(rig):
    jsonschema = pytest.importorskip("jsonschema", reason="the schema is checked with jsonschema")
    for asked in (False, True):
        values = json.loads(export_files(rig, "json", Options(covariance=asked))["rig.json"])
        jsonschema.validate(values, json_schema())
    values["cameras"]["cam0"]["width"] = "wide"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(values, json_schema())


def test_json_says_null_where_nothing_is_known(example_rig):
    values = json.loads(export_files(replace(example_rig, working_accuracy=float("nan")), "json")["rig.json"])
    assert values["working_accuracy_mm"] is None


@pytest.mark.parametrize("form", ["opencv", "opencv-xml", "opencv-json"])
def test_opencv_reads_its_own(form, rig, tmp_path):
    [path] = written(tmp_path, rig, form)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    names = storage.getNode("camera_names")
    assert [names.at(i).string() for i in range(names.size())] == [camera.name for camera in rig.cameras]
    for camera in rig.cameras:
        held = {
            key: storage.getNode(f"{camera.name}_{key}").mat()
            for key in ("camera_matrix", "distortion", "rvec", "tvec", "image_size")
        }
        in_camera = POINTS @ cv2.Rodrigues(held["rvec"])[0].T + held["tvec"].T
        assert_pixels(opencv_pixels(in_camera, held["camera_matrix"], held["distortion"], is_fisheye(rig)), camera)
        assert held["image_size"].ravel().tolist() == [1280, 720]


def test_camera_info_holds_the_lens(rig):
    files = export_files(rig, "ros")
    assert sorted(files) == ["cam0.yaml", "cam1.yaml", "cam2.yaml", "cam3.yaml"]
    for camera in rig.cameras:
        held = yaml.safe_load(files[f"{camera.name}.yaml"])
        matrix = np.reshape(held["camera_matrix"]["data"], (3, 3))
        in_camera = camera.rig_from_camera.inverse().transform(POINTS)
        distortion = held["distortion_coefficients"]["data"]
        assert_pixels(opencv_pixels(in_camera, matrix, distortion, is_fisheye(rig)), camera)
        assert held["distortion_model"] == ("equidistant" if is_fisheye(rig) else "plumb_bob")
        assert (held["image_width"], held["image_height"]) == (1280, 720)


def test_kalibr_chains_from_camera_to_camera(rig):
    if not is_fisheye(rig):
        without = [replace(one.intrinsics, distortion=np.array([-0.1, 0.02, 1e-3, -2e-3, 0])) for one in rig.cameras]
        cameras = [replace(one, intrinsics=lens) for one, lens in zip(rig.cameras, without, strict=True)]
        rig = replace(rig, cameras=tuple(cameras))
    held = yaml.safe_load(export_files(rig, "kalibr")["camchain.yaml"])
    points = rig.cameras[0].rig_from_camera.inverse().transform(POINTS)
    for index, camera in enumerate(rig.cameras):
        entry = held[f"cam{index}"]
        if index:
            points = homogeneous(entry["T_cn_cnm1"], points)
        fx, fy, cx, cy = entry["intrinsics"]
        matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
        assert_pixels(opencv_pixels(points, matrix, entry["distortion_coeffs"], is_fisheye(rig)), camera)
        assert entry["cam_overlaps"] == [other for other in range(4) if other != index]


def test_kalibr_refuses_what_it_cannot_say(rig):
    if not is_fisheye(rig):
        with pytest.raises(QuadrigError, match="k3"):
            export_files(rig, "kalibr")


@pytest.mark.parametrize("form", ["colmap", "colmap-binary"])
def test_colmap_reads_rig_frame_and_images(form, rig, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP's own reader is pycolmap")
    written(tmp_path, rig, form)
    model = pycolmap.Reconstruction(str(tmp_path))
    [held] = model.rigs.values()
    [frame] = model.frames.values()
    assert held.num_sensors() == 4
    for number, camera in enumerate(rig.cameras, start=1):
        image, lens = model.images[number], model.cameras[number]
        assert image.name == f"{camera.name}.jpg"
        in_camera = homogeneous(image.cam_from_world().matrix(), POINTS)
        assert_pixels(lens.img_from_cam(in_camera) - 0.5, camera)  # its pixels begin at the corner
        if number > 1:
            sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=number)
            through_rig = held.sensor_from_rig(sensor).matrix(), frame.rig_from_world.matrix()
            again = homogeneous(through_rig[0], homogeneous(through_rig[1], POINTS))
            np.testing.assert_allclose(again, in_camera, atol=1e-12)


@pytest.mark.parametrize(
    ("form", "unit"), [("anipose", 1.0), ("freemocap", 1e-3), ("pose2sim", 1.0), ("caliscope", 1.0)]
)
def test_toml_holds_camera_from_rig(form, unit, rig):
    [text] = export_files(rig, form).values()
    tables = tomllib.loads(str(text))
    cameras = tables["cameras"] if form == "caliscope" else {k: v for k, v in tables.items() if k != "metadata"}
    for camera, held in zip(rig.cameras, cameras.values(), strict=True):
        assert held["size"] == [1280, 720]
        assert held.get("name", camera.name) == camera.name
        in_camera = POINTS / unit @ rotation_from_vector(np.array(held["rotation"])).T + held["translation"]
        assert held.get("fisheye", False) == is_fisheye(rig)
        assert_pixels(opencv_pixels(in_camera, held["matrix"], held["distortions"], is_fisheye(rig)), camera)
        if form == "freemocap":
            stands = np.array(held["world_position"]) * unit
            np.testing.assert_allclose(stands, camera.rig_from_camera.translation, atol=1e-12)
            np.testing.assert_allclose(held["world_orientation"], camera.rig_from_camera.rotation)


def test_anipose_reads_its_own(rig, tmp_path):
    cameras = pytest.importorskip("aniposelib.cameras", reason="anipose's own reader is aniposelib")
    [path] = written(tmp_path, rig, "anipose")
    for camera, held in zip(rig.cameras, cameras.CameraGroup.load(str(path)).cameras, strict=True):
        assert held.get_name() == camera.name
        assert_pixels(held.project(POINTS).reshape(-1, 2), camera)


def test_caliscope_reads_its_own(rig, tmp_path):
    arrays = pytest.importorskip("caliscope.cameras.camera_array", reason="caliscope's own reader is caliscope")
    [path] = written(tmp_path, rig, "caliscope")
    held = arrays.CameraArray.from_toml(path).cameras
    for camera, seen in zip(rig.cameras, held.values(), strict=True):
        in_camera = POINTS @ seen.rotation.T + seen.translation
        assert_pixels(opencv_pixels(in_camera, seen.matrix, seen.distortions, seen.fisheye), camera)


def test_nerfstudio_looks_along_minus_z(rig):
    values = json.loads(export_files(rig, "nerfstudio")["transforms.json"])
    assert values["camera_model"] == ("OPENCV_FISHEYE" if is_fisheye(rig) else "OPENCV")
    for camera, frame in zip(rig.cameras, values["frames"], strict=True):
        x, y, z = homogeneous(np.linalg.inv(frame["transform_matrix"]), POINTS).T
        matrix = [[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]]
        names = ["k1", "k2", "k3", "k4"] if is_fisheye(rig) else ["k1", "k2", "p1", "p2", "k3"]
        distortion = [frame[name] for name in names]
        in_camera = np.column_stack([x, -y, -z])
        assert_pixels(opencv_pixels(in_camera, matrix, distortion, is_fisheye(rig)) - 0.5, camera)


def test_nerfstudio_has_one_model_for_all(rig, example_rig):
    if is_fisheye(rig):
        with pytest.raises(QuadrigError, match="one camera model"):
            export_files(replace(rig, cameras=(rig.cameras[0], example_rig.cameras[1])), "nerfstudio")


def test_mrcal_reads_its_own(rig, tmp_path):
    if is_fisheye(rig):
        with pytest.raises(QuadrigError, match="fisheye"):
            export_files(rig, "mrcal")
        return
    python = shutil.which("python3", path="/usr/bin")
    if python is None or subprocess.run([python, "-c", "import mrcal"], capture_output=True).returncode:
        pytest.skip("mrcal's own reader is the system's python3-mrcal")
    for path, camera in zip(written(tmp_path, rig, "mrcal"), rig.cameras, strict=True):
        program = (
            "import mrcal, numpy; m = mrcal.cameramodel({!r}); p = numpy.array({!r}); "
            "q = mrcal.project(mrcal.transform_point_rt(m.extrinsics_rt_fromref(), p), *m.intrinsics()); "
            "print(q.tolist(), m.imagersize().tolist())"
        )
        done = subprocess.run(
            [python, "-c", program.format(str(path), POINTS.tolist())], capture_output=True, check=True
        )
        pixels, size = json.loads("[" + done.stdout.decode().replace("]] [", "]], [") + "]")
        assert_pixels(pixels, camera)
        assert size == [1280, 720]


def test_usd_cameras_see_the_same(pinholes, tmp_path):
    pytest.importorskip("pxr", reason="USD's own reader is usd-core")
    gf, usd, geometry = (import_module(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom"))

    [path] = written(tmp_path, pinholes, "usd")
    stage = usd.Stage.Open(str(path))
    world_from_rig = geometry.Xformable(stage.GetPrimAtPath("/Rig")).ComputeLocalToWorldTransform(0)
    assert (geometry.GetStageMetersPerUnit(stage), geometry.GetStageUpAxis(stage)) == (1, "Y")
    for camera in pinholes.cameras:
        seen = geometry.Camera(stage.GetPrimAtPath(f"/Rig/{camera.name}")).GetCamera(0)
        window = seen.frustum.ComputeViewMatrix() * seen.frustum.ComputeProjectionMatrix()
        sides = np.array([window.Transform(world_from_rig.Transform(gf.Vec3d(*point)))[:2] for point in POINTS])
        pixels = (sides * [1, -1] + 1) / 2 * [1280, 720] - 0.5
        assert_pixels(pixels, camera, 3e-4)  # its lenses are float32: 700 px to seven digits


class Anything:
    """Stands for Blender's objects: keeps what is set."""

    def __init__(self, name="", data=None):
        self.name, self.data, self.camera = name, data, None
        self.render: Any = ModuleType("render")
        self.collection = self.objects = self
        self.linked: list[Any] = []

    def link(self, held):
        self.linked.append(held)


def run_in_blender(script: str) -> list[Anything]:
    """The scenes that a script makes in a stand-in for bpy."""
    bpy: Any = ModuleType("bpy")
    mathutils: Any = ModuleType("mathutils")
    scenes: list[Anything] = []

    def new_scene(name):
        scenes.append(Anything(name))
        return scenes[-1]

    makers = {"scenes": new_scene, "objects": Anything, "cameras": Anything}
    bpy.data = ModuleType("data")
    for name, make in makers.items():
        setattr(bpy.data, name, ModuleType(name))
        getattr(bpy.data, name).new = make
    bpy.context = SimpleNamespace(scene=new_scene("Scene"))
    mathutils.Matrix = np.array
    before = {name: sys.modules.get(name) for name in ("bpy", "mathutils")}
    sys.modules.update(bpy=bpy, mathutils=mathutils)
    try:
        exec(script, {})
    finally:
        for name, module in before.items():
            sys.modules.pop(name) if module is None else sys.modules.update({name: module})
    return scenes


def test_blender_makes_cameras_that_see_the_same(pinholes):
    small = pinholes.cameras[3]
    lens = replace(small.intrinsics, width=640, height=480, principal_point=np.array([300.0, 250.0]))
    mixed = replace(pinholes, cameras=(*pinholes.cameras[:3], replace(small, intrinsics=lens)))
    scenes = run_in_blender(str(export_files(mixed, "blender")["rig_blender.py"]))
    assert [(s.render.resolution_x, s.render.resolution_y) for s in scenes] == [(1280, 720), (640, 480)]
    made = {held.name: (held, scene) for scene in scenes for held in scene.linked if held.data is not None}
    assert list(made) == [camera.name for camera in mixed.cameras]
    for camera in mixed.cameras:
        held, scene = made[camera.name]
        width, height = scene.render.resolution_x, scene.render.resolution_y
        world = homogeneous(held.parent.matrix_world, POINTS)
        x, y, z = homogeneous(np.linalg.inv(held.parent.matrix_world @ held.matrix_local), world).T
        film, shift = held.data.lens / held.data.sensor_width, (held.data.shift_x, held.data.shift_y)
        # Blender's film: its width is 1, the shift moves it right and up, and the picture's middle is its middle.
        across, up = film * x / -z - shift[0], film * y / -z - shift[1]
        assert_pixels(np.column_stack([across * width + width / 2, height / 2 - up * width]) - 0.5, camera)


@pytest.mark.parametrize("form", ["usd", "blender"])
def test_what_has_no_distortion_refuses_it(form, rig):
    with pytest.raises(QuadrigError, match="--undistorted"):
        export_files(rig, form)


def test_maps_show_where_each_pixel_comes_from(rig, tmp_path):
    camera = rig.cameras[1]
    alone = replace(rig, cameras=(camera,), fits=(), reference="world")
    across, down = (
        np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) for path in written(tmp_path, alone, "maps")
    )
    assert across.shape == (720, 1280)
    flat = ideal_rig(alone).cameras[0]
    for column, row in ((640, 360), (200, 500), (1000, 100)):
        ray = flat.intrinsics.unproject(np.array([column, row], float))
        np.testing.assert_allclose(
            [across[row, column], down[row, column]], camera.intrinsics.project(ray), atol=1e-4
        )


def test_maps_show_no_edge_twice():
    """A lens whose polynomial turns back at 50 degrees has no ray past that angle."""
    from quadrig.single.lens import Intrinsics

    lens = Intrinsics(640, 480, 250.0, np.array([319.5, 239.5]), np.array([-0.25, 0.0, 0.0, 0.0, 0.0]))
    places = undistortion_map(lens)
    assert np.isfinite(places[240, 320]).all()
    rays = (np.indices((480, 640))[::-1].T.swapaxes(0, 1) - lens.principal_point) / 250.0
    folded = np.linalg.norm(rays, axis=-1) > np.sqrt(1 / 0.75)
    assert folded.any()
    assert np.isnan(places[folded]).all()


def test_ffmpeg_remaps_by_its_maps(rig, tmp_path):
    av = pytest.importorskip("av", reason="FFmpeg's remap is run through PyAV")
    camera = rig.cameras[1]
    x_map, y_map = written(tmp_path, replace(rig, cameras=(camera,), fits=(), reference="world"), "ffmpeg")
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (720, 1280), np.uint8)
    graph = av.filter.Graph()
    source = graph.add_buffer(width=1280, height=720, format="gray", time_base=1)
    maps = [graph.add_buffer(width=1280, height=720, format="gray16le", time_base=1) for _ in "xy"]
    remap, sink = graph.add("remap"), graph.add("buffersink")
    for port, each in enumerate((source, *maps)):
        each.link_to(remap, 0, port)
    remap.link_to(sink)
    graph.configure()
    tables = [np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) for path in (x_map, y_map)]
    pictures: list[Any] = [picture, *tables]
    for each, image, form in zip((source, *maps), pictures, ("gray", "gray16le", "gray16le"), strict=True):
        frame = av.VideoFrame.from_ndarray(image, format=form)
        frame.pts, frame.time_base = 0, 1
        each.push(frame)
        each.push(None)
    done = sink.pull().reformat(format="gray").to_ndarray()
    across, down = tables
    inside = across != 65535
    np.testing.assert_array_equal(done[inside], picture[down[inside], across[inside]])


def frames_of(robot) -> dict[str, np.ndarray]:
    """Where every link stands in the root, by URDF's rules."""
    joints = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}

    def placed(link):
        if link not in joints:
            return np.eye(4)
        origin, parent = joints[link].find("origin"), joints[link].find("parent").get("link")
        pose = Pose(
            from_roll_pitch_yaw(*(float(v) for v in origin.get("rpy").split())),
            np.array([float(v) for v in origin.get("xyz").split()]),
        )
        return placed(parent) @ pose.matrix()

    return {link.get("name"): placed(link.get("name")) for link in robot.findall("link")}


def test_urdf_and_launch_place_links_in_the_base_frame(example_rig):
    base = Options(base="base_link", base_from_rig=TURNED)
    robot = ElementTree.fromstring(export_files(example_rig, "urdf", base)["rig.urdf"])
    frames = frames_of(robot)
    cameras = [f"{camera.name}_{what}" for camera in example_rig.cameras for what in ("link", "optical")]
    assert set(frames) == {"base_link", *cameras, "desk", "wall"}
    for camera in example_rig.cameras:
        optical, link = frames[f"{camera.name}_optical"], frames[f"{camera.name}_link"]
        np.testing.assert_allclose(optical, (TURNED @ camera.rig_from_camera).matrix(), atol=1e-12)
        # REP 103: what lies ahead of the camera (z) is along the body's x, what is right of it along -y.
        np.testing.assert_allclose(link[:3, 0], optical[:3, 2], atol=1e-12)
        np.testing.assert_allclose(link[:3, 1], -optical[:3, 0], atol=1e-12)
    launch = ElementTree.fromstring(export_files(example_rig, "tf")["rig.launch.xml"])
    assert len(launch.findall("node")) == 10
    assert "--frame-id rig --child-frame-id cam0_link" in launch.findall("node")[0].attrib["args"]


def test_a_urdf_reader_agrees(example_rig, tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy", reason="a reader of URDF")
    [path] = written(tmp_path, example_rig, "urdf")
    robot = yourdfpy.URDF.load(str(path), build_scene_graph=True, load_meshes=False)
    for camera in example_rig.cameras:
        found = robot.get_transform(f"{camera.name}_optical", "rig")
        np.testing.assert_allclose(found, camera.rig_from_camera.matrix(), atol=1e-9)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_upright_links_have_angles_too(pitch):
    about_z, about_y = rotation_from_vector(np.array([0, 0, 0.7])), rotation_from_vector(np.array([0, pitch, 0]))
    again = from_roll_pitch_yaw(*roll_pitch_yaw(about_z @ about_y))
    np.testing.assert_allclose(again, about_z @ about_y, atol=1e-8)  # upright, an angle is known to root epsilon


def test_cameras_without_a_pose_go_where_lenses_go_alone(example_rig):
    alone = replace(example_rig, cameras=(replace(example_rig.cameras[0], name="alone"),), reference="alone", fits=())
    both = replace(example_rig, apart=(replace(alone, covariance=example_rig.covariance[:15, :15]),))
    assert "alone.yaml" in export_files(both, "ros")
    assert "alone" in json.loads(export_files(both, "json")["rig.json"])["lens_only"]
    done = export_rig(both, "kalibr")
    assert done.notes == ("kalibr holds no camera without a pose: without alone",)
    flat = yaml.safe_load(export_files(ideal_rig(both), "ros")["alone.yaml"])
    assert not any(flat["distortion_coefficients"]["data"])


def named(rig: Rig, *names: str) -> Rig:
    cameras: list[Camera] = [replace(one, name=name) for one, name in zip(rig.cameras, names, strict=False)]
    return replace(rig, cameras=tuple(cameras), fits=(), reference=names[0])


def test_names_that_fall_together_are_told_apart():
    assert plain_names(["left eye", "0", "left/eye", "LEFT_EYE", "left\neye"]) == [
        "left_eye", "cam_0", "left_eye_2", "LEFT_EYE_3", "left_eye_4",
    ]  # fmt: skip


def test_frames_have_names_of_their_own(example_rig):
    """Rectangles that are called like the base, or like a camera's frame, are called otherwise."""
    named_so = [
        replace(placed, rectangle=replace(placed.rectangle, name=name))
        for placed, name in zip(example_rig.rectangles, ("board", "rig", "cam1_optical"), strict=True)
    ]
    robot = ElementTree.fromstring(export_files(replace(example_rig, rectangles=tuple(named_so)), "urdf")["rig.urdf"])
    links = [link.get("name") for link in robot.findall("link")]
    assert len(links) == len(set(links)) == 11
    assert {"rig_2", "cam1_optical_2"} < set(links)
    with pytest.raises(QuadrigError, match="no frame can be called 'base link'"):
        export_files(example_rig, "urdf", Options(base="base link"))


@pytest.mark.parametrize("form", [name for name, form in FORMATS.items() if form.write is not None])
def test_every_format_takes_every_name(form, pinholes, tmp_path):
    names = ["left eye", "left/eye", "Left\neye", 'a "quoted" ünï']
    done = export_rig(named(pinholes, *names), form)
    changed = [note for note in done.notes if "cannot hold" in note]
    if form in ("json", "opencv", "opencv-xml", "opencv-json", "anipose", "freemocap", "pose2sim"):
        from quadrig.io.formats.any_file import read_any_rig

        assert changed == []
        [path] = written(tmp_path, named(pinholes, *names), form)
        assert [camera.name for camera in read_any_rig(path).cameras] == names
    else:
        assert len(changed) == 4
        assert all("/" not in file and "\n" not in file for file in done.files)
    assert len(done.files) == len({file.casefold() for file in done.files})


def test_json_holds_bodies_with_their_sigmas(carried_rig, tmp_path):
    (hall,) = carried_rig.bodies
    values = json.loads(json_text(rig_values(carried_rig)))["bodies"]["hall"]
    assert values["is_room"]
    assert values["framesets"] == list(range(12))
    assert values["rectangles"]["north"]["sigma"] == {"rotation_deg": 0, "position_m": 0}
    assert values["rectangles"]["west"]["sigma"]["position_m"] == pytest.approx(2e-3)
    assert values["sigma"]["rotation_deg"] == pytest.approx([np.degrees(1e-3)] * 12)
    path = tmp_path / "rig.json"
    path.write_text(json_text(rig_values(carried_rig)))
    again = read_json(path).rig
    assert again is not None
    assert [placed.rectangle.body for placed in again.rectangles] == ["hall"] * 4
    (back,) = again.bodies
    np.testing.assert_allclose(back.rig_from_body.matrix(), hall.rig_from_body.matrix(), atol=1e-12)
    np.testing.assert_allclose(back.body_from_rect.matrix(), hall.body_from_rect.matrix(), atol=1e-12)
    assert again.room is back
    assert np.isnan(back.layout_covariance).all()

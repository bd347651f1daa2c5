"""Lenses out of files, for the cameras of a recording: what is wrong is said before anything is searched."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.formats.rig_json import json_text, rig_values
from quadrig.io.rig_file.rig_mcap import read_rig, write_rig
from quadrig.io.search.known_lenses import read_known_lenses, with_known_lenses
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import CAMERA_PARAMETERS
from quadrig.single.errors import QuadrigError
from quadrig.single.lens_prior import LensEvidence

INPUTS = [CameraInput("cam0", 1280, 720), CameraInput("door", 1280, 720)]


@pytest.fixture
def with_evidence(example_rig):
    evidence = LensEvidence(np.arange(9.0), np.diag(np.arange(9.0)))
    cameras = tuple(replace(camera, lens_evidence=evidence) for camera in example_rig.cameras)
    return replace(example_rig, cameras=cameras)


def test_what_views_said_goes_through_the_file(with_evidence, tmp_path):
    write_rig(tmp_path / "rig.mcap", with_evidence)
    (cam0, door), notes = with_known_lenses(INPUTS, read_known_lenses([str(tmp_path / "rig.mcap")]))
    assert cam0.lens_evidence is not None
    assert cam0.intrinsics is not None
    np.testing.assert_array_equal(cam0.lens_evidence.information, np.diag(np.arange(9.0)))
    np.testing.assert_array_equal(cam0.lens_evidence.pull, np.arange(9.0))
    assert cam0.intrinsics.focal == read_rig(tmp_path / "rig.mcap").camera("cam0").intrinsics.focal
    assert (cam0.lens_covariance, cam0.fixed, door, notes) == (None, False, INPUTS[1], [])


def test_a_kept_lens_is_held_against_its_own_doubt(with_evidence, tmp_path):
    write_rig(tmp_path / "rig.mcap", with_evidence)
    (cam0, _), _ = with_known_lenses(INPUTS, read_known_lenses([str(tmp_path / "rig.mcap")]), keep=True)
    assert (cam0.fixed, cam0.lens_evidence) == (True, None)
    assert cam0.lens_covariance is not None
    np.testing.assert_allclose(cam0.lens_covariance, with_evidence.lens_covariance("cam0"))


def test_a_file_with_sigmas_alone_claims_no_more_than_any_correlation_allows(example_rig, tmp_path):
    (tmp_path / "rig.json").write_text(json_text(rig_values(example_rig)))
    (cam0, _), _ = with_known_lenses(INPUTS, read_known_lenses([str(tmp_path / "rig.json")]))
    true = example_rig.lens_covariance("cam0")
    assert np.linalg.eigvalsh(cam0.lens_covariance - true).min() > -1e-12


def test_a_lens_for_another_name_and_kept(example_rig, tmp_path):
    own = slice(CAMERA_PARAMETERS)
    one = replace(example_rig, cameras=example_rig.cameras[:1], covariance=example_rig.covariance[own, own])
    write_rig(tmp_path / "one.mcap", one)
    lenses = read_known_lenses([f"door={tmp_path / 'one.mcap'}"])
    (_, door), (note,) = with_known_lenses(INPUTS, lenses, keep=True)
    assert door.fixed
    assert door.intrinsics is not None
    assert "no sigma holds their doubt" in note
    assert door.intrinsics.focal == example_rig.cameras[0].intrinsics.focal


@pytest.mark.parametrize(
    ("given", "inputs", "said"),
    [
        (["{}"], [CameraInput("x", 1280, 720)], "give a lens as NAME=FILE"),
        (["{}"], [CameraInput("cam0", 640, 360)], "give a lens for this size"),
        (["door={}"], INPUTS, "give one of one lens for door"),
        (["{}", "{}"], INPUTS, "give each lens once"),
        (["cam0=nothing.mcap"], INPUTS, "nothing.mcap"),
    ],
)
def test_what_is_wrong_is_one_sentence(example_rig, tmp_path, given, inputs, said):
    write_rig(tmp_path / "rig.mcap", example_rig)
    with pytest.raises(QuadrigError, match=said):
        with_known_lenses(inputs, read_known_lenses([each.format(tmp_path / "rig.mcap") for each in given]))

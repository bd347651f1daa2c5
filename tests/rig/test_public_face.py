"""`from quadrig.rig import ...`: every public name, whatever was imported before."""

import subprocess
import sys
from importlib import import_module

import pytest

import quadrig.rig


@pytest.mark.parametrize("name", quadrig.rig.__all__)
def test_every_public_name_is_there(name):
    assert getattr(quadrig.rig, name) is not None
    assert name in dir(quadrig.rig)


def test_functions_stay_functions_after_their_modules_were_imported():
    for module in ("calibration", "recalibration", "comparison", "moved", "doubt.verdict", "doubt.working_accuracy"):
        import_module(f"quadrig.rig.{module}")
    from quadrig.rig import CameraInput, Rectangle, View, calibrate, compare, find_moved, recalibrate, verdict

    assert all(callable(each) for each in (calibrate, compare, find_moved, recalibrate, verdict))
    assert all(isinstance(each, type) for each in (CameraInput, Rectangle, View))


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"quadrig\.rig.*'calibrat'"):
        _ = quadrig.rig.calibrat


def test_importing_the_package_loads_nothing_heavy():
    script = "import sys, quadrig.rig; print([m for m in ('numpy', 'scipy', 'cv2', 'networkx') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

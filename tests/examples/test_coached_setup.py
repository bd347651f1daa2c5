"""The example of the coached person runs, and obeying costs fewer framesets than waving."""

import re
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "06_coached_setup.py"


def test_the_coached_person_needs_fewer_framesets():
    done = subprocess.run([sys.executable, str(EXAMPLE), "--rigs", "1"], capture_output=True, text=True, check=True)
    found = re.search(r"together (\d+) framesets obeying, (\d+) waving", done.stdout)
    assert found is not None
    # One rig is no statistics: it only has to be no worse.
    assert int(found[1]) <= int(found[2])

"""Recordings and rig.toml in; rig.mcap, exports and reports out. The `rig` command is made of these."""

import sys
from typing import TYPE_CHECKING, Any

from quadrig.single.lazy import lazy_names

if TYPE_CHECKING:
    from quadrig.io.config.rig_toml import CameraConfig as CameraConfig
    from quadrig.io.config.rig_toml import RigConfig as RigConfig
    from quadrig.io.config.rig_toml import parse_config as parse_config
    from quadrig.io.config.rig_toml import read_config as read_config
    from quadrig.io.config.rig_toml import write_config as write_config
    from quadrig.io.formats.any_file import KnownLens as KnownLens
    from quadrig.io.formats.any_file import read_any_lenses as read_any_lenses
    from quadrig.io.formats.any_file import read_any_rig as read_any_rig
    from quadrig.io.formats.registry import export_files as export_files
    from quadrig.io.recording.framesets import Framesets as Framesets
    from quadrig.io.recording.framesets import build_framesets as build_framesets
    from quadrig.io.recording.recorded_cameras import RecordedCamera as RecordedCamera
    from quadrig.io.recording.recorded_cameras import Recording as Recording
    from quadrig.io.recording.recorded_cameras import open_recording as open_recording
    from quadrig.io.report.page import report_html as report_html
    from quadrig.io.rig_file.rig_mcap import RigFile as RigFile
    from quadrig.io.rig_file.rig_mcap import read_rig as read_rig
    from quadrig.io.rig_file.rig_mcap import read_rig_file as read_rig_file
    from quadrig.io.rig_file.rig_mcap import write_rig as write_rig
    from quadrig.io.search.choose_frames import choose_frames as choose_frames
    from quadrig.io.search.detections import find_views as find_views
    from quadrig.io.search.effort import Effort as Effort
    from quadrig.io.search.whole_recording import Searched as Searched
    from quadrig.io.search.whole_recording import calibrate_recording as calibrate_recording
    from quadrig.io.search.whole_recording import calibrate_searched as calibrate_searched
    from quadrig.io.search.whole_recording import search_recording as search_recording
    from quadrig.io.version import __version__ as __version__

_MODULE_OF = {
    "CameraConfig": "config.rig_toml",
    "RigConfig": "config.rig_toml",
    "parse_config": "config.rig_toml",
    "read_config": "config.rig_toml",
    "write_config": "config.rig_toml",
    "KnownLens": "formats.any_file",
    "read_any_lenses": "formats.any_file",
    "read_any_rig": "formats.any_file",
    "export_files": "formats.registry",
    "Framesets": "recording.framesets",
    "build_framesets": "recording.framesets",
    "RecordedCamera": "recording.recorded_cameras",
    "Recording": "recording.recorded_cameras",
    "open_recording": "recording.recorded_cameras",
    "report_html": "report.page",
    "RigFile": "rig_file.rig_mcap",
    "read_rig": "rig_file.rig_mcap",
    "read_rig_file": "rig_file.rig_mcap",
    "write_rig": "rig_file.rig_mcap",
    "choose_frames": "search.choose_frames",
    "find_views": "search.detections",
    "Effort": "search.effort",
    "Searched": "search.whole_recording",
    "calibrate_recording": "search.whole_recording",
    "calibrate_searched": "search.whole_recording",
    "search_recording": "search.whole_recording",
    "__version__": "version",
}

__all__ = list(_MODULE_OF)
__getattr__, __dir__ = lazy_names(__name__, _MODULE_OF)


def _show_rigs_in_notebooks() -> None:
    """A Rig at the end of a notebook's cell shows itself."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None and hasattr(shell, "kernel"):
        shell.display_formatter.ipython_display_formatter.for_type_by_name("quadrig.rig.result", "Rig", _show)


def _show(rig: Any) -> None:
    from quadrig.io.viewer.notebook import show_in_notebook

    show_in_notebook(rig)


_show_rigs_in_notebooks()

"""One recording of a fleet calibrated in a process of its own: from files to a file, and one line of words."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from quadrig.io.batch.fleet import FleetJob
from quadrig.io.config.corners_toml import PointedCorners
from quadrig.io.config.rig_toml import parse_config
from quadrig.io.formats.any_file import KnownLens
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.io.search.detection_file import detections_beside
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_searched, refuse_missing, search_recording
from quadrig.rig.doubt.lens_accuracy import accuracy_in_words
from quadrig.rig.words import counted


@dataclass(frozen=True)
class CalibrateOne:
    """What run_fleet calls for every recording: `rig calibrate` with one rig.toml for all.

    config_text: the rig.toml; it travels to other machines where the recordings have the same paths, the rig.toml
    perhaps not. keep: what was found, beside the rig, for the next run. corners: given by hand, the same for all.
    lenses, keep_lenses: as search_recording has them.
    """

    config_text: str
    tolerance: float | None = None
    share: float = 1.0
    all_cameras: bool = False
    keep: bool = True
    corners: tuple[PointedCorners, ...] = ()
    rate: float | None = None
    lenses: Mapping[str, KnownLens] = field(default_factory=dict)
    keep_lenses: bool = False

    def __call__(self, job: FleetJob) -> str:
        """Calibrates one recording and writes its rig. Raises QuadrigError as `rig calibrate` does."""
        config = replace(parse_config(self.config_text), corners=self.corners)
        # Every process has one recording: it searches by itself and shows no bar of its own.
        cache = detections_beside(job.output) if self.keep else None
        effort = Effort(self.tolerance, self.share, workers=1, cache=cache, progress=False, rate=self.rate)
        searched = search_recording(job.recording, config, effort, lenses=self.lenses, keep_lenses=self.keep_lenses)
        rig = calibrate_searched(searched)
        if self.all_cameras:
            refuse_missing(rig)
        write_rig(job.output, rig, self.config_text, searched.times, job.recording)
        without = f", without {', '.join(rig.missing)}" if rig.missing else ""
        return (
            f"good for {accuracy_in_words(rig)}, {counted(len(rig.cameras), 'camera')}{without}, RMS {rig.rms:.3f} px"
        )

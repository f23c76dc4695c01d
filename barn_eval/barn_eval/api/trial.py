"""A single trial: its row and its trajectory."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from barn_eval.results.tracks import CHANNELS, parse_track_line
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import write_durably

# Units of the channels of a track.
_UNITS = ("s", "m", "m", "rad", "mps", "radps", "mps", "radps", "m")


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial of a run."""

    result: TrialResult
    """Its row."""

    track: str | None
    """Line of its track; None if the robot did not drive."""

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """DataFrame of the track in the map frame, 5 rows a second; empty without one.

        Columns: time_s since the first reading, x_m, y_m, yaw_rad, speed_mps,
        turn_radps, command_speed_mps and command_turn_radps (NaN without a command),
        clearance_m (smallest since the previous row; NaN without obstacles), contact
        (since the previous row). Empty if the robot did not drive.
        """
        names = [
            f"{channel}_{unit}" for channel, unit in zip(CHANNELS, _UNITS, strict=True)
        ]
        # Without a track, the table has the same columns but no rows.
        samples = np.empty((0, len(names)))
        contact = np.empty(0, np.bool_)
        if self.track is not None:
            _, track = parse_track_line(self.track, self.result.trial_id)
            samples = track.samples
            contact = track.contact
        columns = dict(zip(names, samples.T, strict=True))
        return pd.DataFrame(columns | {"contact": contact})

    def to_tum(self, path: str | Path) -> Path:
        """Write the trajectory as TUM text (for evo), return its path; ConfigError if empty.

        Args:
            path: File to write: a line per pose of timestamp [s], x y z [m] and the
                quaternion qx qy qz qw.

        Returns:
            The path.

        Raises:
            BarnError: If there is no trajectory, or the file cannot be written.
        """
        trajectory = self.trajectory
        if trajectory.empty:
            raise ConfigError(f"{self.result.trial_id}: no trajectory")
        half_yaw = trajectory["yaw_rad"].to_numpy() / 2.0
        # The robot stays on the ground and turns about the vertical axis only.
        poses = trajectory[["time_s", "x_m", "y_m"]].assign(
            z=0.0, qx=0.0, qy=0.0, qz=np.sin(half_yaw), qw=np.cos(half_yaw)
        )
        text = poses.to_csv(sep=" ", float_format="%.9g", header=False, index=False)
        write_durably(Path(path), text.encode())
        return Path(path)

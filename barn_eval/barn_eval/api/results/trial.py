"""A single trial: its result, and what the robot did."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from barn_eval.results.tracks import CHANNELS, parse_track_line
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import write_durably

UNITS = (
    "s",
    "m",
    "m",
    "rad",
    "mps",
    "radps",
    "mps",
    "radps",
    "m",
)  # of the channels of a track


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial of an experiment: its `result`, and the `trajectory` that its folder keeps.

    track: line of its track, None where nothing was driven.
    """

    result: TrialResult
    track: str | None

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """What the robot did, five times a second, and where the trial ended; in the map frame.

        Columns: time_s since the first reading, x_m, y_m, yaw_rad, speed_mps, turn_radps, command_speed_mps and
        command_turn_radps (NaN: none), clearance_m (smallest since the row before; NaN: no obstacles), contact (since
        the row before). Empty if nothing was driven.
        """
        names = [
            f"{channel}_{unit}" for channel, unit in zip(CHANNELS, UNITS, strict=True)
        ]
        if self.track is None:
            return pd.DataFrame(
                {name: np.empty(0) for name in names}
                | {"contact": np.empty(0, np.bool_)}
            )
        _, track = parse_track_line(self.track, self.result.trial_id)
        return pd.DataFrame(
            dict(zip(names, track.samples.T, strict=True)) | {"contact": track.contact}
        )

    def to_tum(self, path: str | Path) -> Path:
        """Write the trajectory in the format of the TUM RGB-D benchmark, as evo reads it.

        Args:
            path: File to write: a line per pose of timestamp [s], x y z [m] and the quaternion qx qy qz qw.

        Returns:
            The path.

        Raises:
            BarnError: There is no trajectory, or the file cannot be written.
        """
        frame = self.trajectory
        if frame.empty:
            raise ConfigError(f"{self.result.trial_id}: has no trajectory")
        half, zero = frame["yaw_rad"].to_numpy() / 2.0, np.zeros(len(frame))
        place = (frame[name].to_numpy() for name in ("time_s", "x_m", "y_m"))
        rows = np.column_stack([*place, zero, zero, zero, np.sin(half), np.cos(half)])
        text = "".join(
            " ".join(f"{value:.9g}" for value in row) + "\n" for row in rows.tolist()
        )
        write_durably(Path(path), text.encode())
        return Path(path)

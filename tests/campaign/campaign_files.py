"""The files of a campaign, for edits as text, so that nothing here is shared with the package."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tomlkit


class Files:
    """The files of a campaign, for edits."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.document = tomlkit.parse((folder / "campaign.toml").read_text(encoding="utf-8"))
        self.runs = [dict(run) for run in self.document["run"]]

    def of(self, *procedures: str) -> list[dict]:
        return [run for run in self.runs if run["procedure"] in procedures]

    def has(self, run: dict, column: str) -> bool:
        with (self.folder / run["file"]).open(encoding="utf-8", newline="") as stream:
            return column in next(csv.reader(stream))

    def channels(self, kind: str) -> list[str]:
        return [str(channel["name"]) for channel in self.document["channel"] if channel["kind"] == kind]

    def contrast(self, run: dict, first: str, second: str) -> float:
        """Difference of the rates that two channels see in a run, as a share of that of the table.

        Decides beforehand whether an exchange of the two can be seen.
        """
        mounting = next(each for each in self.document["mounting"] if each["name"] == run["mounting"])
        axis = np.array(mounting.get("body_to_table", [[3**-0.5] * 3] * 3)[2], dtype=float)
        inputs = {str(each["name"]): np.array(each["input_axis"], dtype=float) for each in self.document["channel"]}
        return abs(float(axis @ (inputs[first] - inputs[second])))

    def input_along(self, run: dict, channel: str, kind: str) -> float:
        """Largest share of the rate of a table, or of gravity about a horizontal axis, that a channel sees in a run."""
        mounting = next(each for each in self.document["mounting"] if each["name"] == run["mounting"])
        axis = np.array(mounting.get("body_to_table", [[3**-0.5] * 3] * 3)[2], dtype=float)
        along = next(each["input_axis"] for each in self.document["channel"] if each["name"] == channel)
        share = abs(float(axis @ np.array(along, dtype=float) / np.linalg.norm(along)))
        return share if kind == "gyro" else float(np.sqrt(max(1 - share**2, 0.0)))

    def save(self) -> None:
        (self.folder / "campaign.toml").write_text(tomlkit.dumps(self.document), encoding="utf-8")

    def edit(self, run: dict, change: Callable[[dict[str, list[str]]], None]) -> None:
        """Change the columns of a run table, name → cells."""
        file = self.folder / run["file"]
        with file.open(encoding="utf-8", newline="") as stream:
            head, *rows = list(csv.reader(stream))
        columns = {name: [row[place] for row in rows] for place, name in enumerate(head)}
        change(columns)
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))

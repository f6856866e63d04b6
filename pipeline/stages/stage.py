"""What a stage is: a function of the scene and the run folder, and the files that it writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.runs.run_folder import RunFolder

Log = Callable[[str], None]  # takes a line of text for the user


@dataclass(frozen=True)
class Stage:
    name: str
    run: Callable[[Config, Prepared, RunFolder, Log], dict]  # returns what stages.json keeps of it
    outputs: tuple[str, ...] = ()  # files, by their names in RunFolder; none: stages.json has its result

    def is_done(self, folder: RunFolder, inputs: str) -> bool:
        """Whether it was finished with these inputs; a stage whose output was deleted is not done."""
        return folder.inputs_of(self.name) == inputs and all(getattr(folder, name).exists() for name in self.outputs)

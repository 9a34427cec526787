"""The regression gate as pytest items: every row of every scenario's ``gate`` is a test.

In the configuration of pytest::

    mjmerge_scenarios = ["my_scenarios"]      # folders of scenario files
    mjmerge_baselines = "my_baselines"        # by default, baselines/ beside each scenario
    testpaths = ["tests", "my_scenarios"]
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from mjmerge.gate.result import Result, RowResult


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declares the configuration."""
    parser.addini(
        "mjmerge_scenarios", "folders of scenarios whose gate rows are tests", type="paths", default=[]
    )
    parser.addini("mjmerge_baselines", "folder of their baselines", type="string", default="")


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collects the scenarios of the folders in the configuration."""
    folders = parent.config.getini("mjmerge_scenarios")
    if file_path.suffix != ".yaml" or file_path.parent not in folders:
        return None
    collected: pytest.Collector = ScenarioFile.from_parent(parent, path=file_path)
    return collected


class ScenarioFile(pytest.File):
    """A scenario; its rows are run together, once."""

    _results: dict[str, Result] | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """An item per row of its gate."""
        from mjmerge.gate import gate
        from mjmerge.scenario.load import load

        rows = gate.rows([self.path]) if load(self.path).gate else []
        for row in rows:
            yield GateItem.from_parent(self, name=row.check.name, row=row, rows=rows)

    def result(self, rows: list[RowResult], name: str) -> Result:
        """What came of a row."""
        from mjmerge.gate import gate

        if self._results is None:
            given = self.config.getini("mjmerge_baselines")
            baselines = self.config.rootpath / given if given else None
            wanted = {item.name for item in self.session.items if item.parent is self}
            found = gate.run([row for row in rows if row.check.name in wanted], baselines)
            self._results = {result.row.check.name: result for result in found}
        return self._results[name]


class GateItem(pytest.Item):
    """A row of the gate."""

    def __init__(self, *, row: RowResult, rows: list[RowResult], **given: Any) -> None:
        super().__init__(**given)
        self._row, self._rows = row, rows

    def runtest(self) -> None:
        """Fails with what is wrong, and the command that shows it."""
        from mjmerge.gate.report import gate_failure

        assert isinstance(self.parent, ScenarioFile)
        result = self.parent.result(self._rows, self.name)
        if result.problems:
            pytest.fail(gate_failure(result), pytrace=False)

    def reportinfo(self) -> tuple[Path, None, str]:
        """How the item is called in reports."""
        return self.path, None, f"{self.path.stem}, {self.name}"

"""Cars that are not as they should be: copies of a shipped one with their text changed."""

import shutil
from collections.abc import Callable

import pytest

from mjmerge.config import shipped


@pytest.fixture
def altered_car(tmp_path) -> Callable:
    """Makes a copy of a car, changed in its MJCF, its shared parts and its data sheet; gives its folder."""

    def make(*changes, base="rc", shared=(), sheet=(), called="own"):
        folder = tmp_path / called
        shutil.copytree(shipped.models()[base], folder)
        if not (tmp_path / "parts").exists():
            shutil.copytree(shipped.folder("models") / "parts", tmp_path / "parts")
        (folder / f"{base}.xml").rename(folder / f"{called}.xml")
        wanted = (folder / f"{called}.xml", changes), (tmp_path / "parts" / "car.xml", shared)
        for file, some in (*wanted, (folder / "datasheet.yaml", sheet)):
            text = file.read_text()
            for old, new in some:
                assert old in text
                text = text.replace(old, new)
            file.write_text(text)
        return folder

    return make

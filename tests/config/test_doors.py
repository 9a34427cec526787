"""What somebody brings from outside is found by its name, or it is said why not; workers find it too."""

import pickle
import signal
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from mjmerge.config.doors import DoorError, carry, code_of, let_in, located, resolve, told

GROUP = "mjmerge.nothing"


@pytest.fixture
def write(tmp_path):
    def make(text, name="mine.py"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return located(f"{name}:Thing", tmp_path, GROUP)

    return make


def test_a_file_is_found_beside_the_one_that_names_it_first_and_then_here(tmp_path, monkeypatch):
    there = tmp_path / "there"
    there.mkdir()
    (tmp_path / "mine.py").write_text("Thing = 'here'")
    monkeypatch.chdir(tmp_path)
    assert resolve(located("mine.py:Thing", there, GROUP)) == "here"
    (there / "mine.py").write_text("Thing = 'beside'")
    assert resolve(located("mine.py:Thing", there, GROUP)) == "beside"
    assert resolve(located("collections.abc:Mapping.get", None, GROUP)).__name__ == "get"


def test_a_file_that_has_changed_is_read_again_and_one_that_has_not_is_not(write):
    name = write("Thing = object()")
    first = resolve(name)
    assert resolve(name) is first
    write("Thing = 2")
    assert resolve(name) == 2


def test_the_code_is_the_text_of_the_file_and_its_digest(write, tmp_path):
    name = write("Thing = 'ü'\n")
    code = code_of(name)
    assert (code.name, code.source) == (f"{tmp_path / 'mine.py'}:Thing", "Thing = 'ü'\n")
    assert code.sha256 == sha256(code.source.encode()).hexdigest()
    assert "class JSONDecoder" in code_of("json.decoder:JSONDecoder").source


def test_what_stands_beside_a_file_can_be_imported_by_it(write, tmp_path):
    (tmp_path / "beside_it.py").write_text("x = 7")
    assert resolve(write("from beside_it import x as Thing")) == 7
    assert str(tmp_path) not in sys.path


def test_a_file_can_be_carried_to_where_it_is_not(write, tmp_path, monkeypatch):
    monkeypatch.setattr("mjmerge.config.doors._carried", {})
    name = write("Thing = 'ü', __file__\n")
    thing, path = resolve(name), str(tmp_path / "mine.py")
    assert thing == ("ü", path)
    texts = let_in()
    Path(path).write_text("Thing = 'edited since'")
    assert let_in()[path] == texts[path]
    Path(path).unlink()
    (module,) = [name for name, one in sys.modules.items() if getattr(one, "__file__", None) == path]
    del sys.modules[module]  # as in another process
    with pytest.raises(DoorError, match="cannot read"):
        resolve(name)
    carry({path: texts[path]})
    assert resolve(name) == thing
    carry({path: "Thing = 2"})  # which was edited and let in again, where it comes from
    assert sys.modules[module].Thing == resolve(name) == 2


def test_what_is_let_in_here_and_carried_here_may_be_edited(write, tmp_path):
    name = write("Thing = 1")
    assert resolve(name) == 1
    carry(let_in())
    assert resolve(write("Thing = 2")) == 2


def test_another_process_finds_the_class_of_what_it_is_sent(write, tmp_path):
    thing = resolve(write("class Thing:\n    def __init__(self): self.x = 5\n"))()
    (tmp_path / "sent").write_bytes(pickle.dumps(thing))
    code = "import sys, pickle, mjmerge.config.doors; print(pickle.load(open(sys.argv[1], 'rb')).x)"
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "sent"], capture_output=True, text=True, check=True
    )
    assert done.stdout == "5\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("class Thong: pass", "mine.py has no 'Thing': did you mean 'Thong'?"),
        ("", "mine.py has no 'Thing': there are none"),
        ("x = \n", "mine.py, line 1: invalid syntax"),
        ("import math\n\nThing = math.nothing\n", "mine.py, line 3: AttributeError: module 'math' has no"),
        ("import sys\nsys.exit(3)", "mine.py, line 2: SystemExit: 3"),
        ("def f():\n    raise ValueError('a\\nb')\n\nf()", "mine.py, line 2: ValueError: a"),
        ("import nothing_of_that_name", "ModuleNotFoundError: No module named 'nothing_of_that_name'"),
    ],
)
def test_code_that_does_not_run_or_lacks_the_name_is_told_with_its_line(write, text, says):
    with pytest.raises(DoorError) as refused:
        resolve(write(text))
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_it_prints_is_no_part_of_the_output(write, capsys):
    assert resolve(write("print('hello')\nThing = 3")) == 3
    assert capsys.readouterr() == ("", "hello\n")


def test_a_command_that_is_told_to_end_ends_whatever_code_it_is_in():
    with pytest.raises(SystemExit), told(None):
        raise SystemExit(128 + signal.SIGTERM)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nothing.py:Thing", "there is no file nothing.py"),
        ("nothing.at_all:Thing", "no module called 'nothing.at_all'"),
        ("json:lods", "json has no 'lods': did you mean 'loads'?"),
        (":Thing", "no module called ''"),
        ("x" * 5000 + ".py:Thing", "there is no file xxx"),
    ],
)
def test_what_is_not_there_is_told(name, says, tmp_path):
    with pytest.raises(DoorError) as refused:
        resolve(located(name, tmp_path, GROUP))
    assert says in str(refused.value)
    assert len(str(refused.value)) < 400

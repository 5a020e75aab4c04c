"""The command line itself: help is instant, errors are one line, every way to end has its exit code."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import click
import pytest

import omnisyn_cli
from cli.cli_samples import Omnisyn, folder_arguments, listing, pair_arguments, start_cli, write_pair
from omnisyn_cli.cli import COMMANDS, cli
from omnisyn_cli.cli.failures import EXIT_CODES, EXIT_CODES_LINE
from omnisyn_cli.errors import InputError, OmnisynError

HEAVY = {
    "torch", "onnxruntime", "numba", "cv2", "OpenImageIO", "numpy", "pydantic", "rich", "ffmpeg", "scipy", "matplotlib",
}  # fmt: skip


@pytest.mark.parametrize(
    "words",
    ["--help", "--version", "interpolate --help", "info --help", "bench --help", "eval --help", "poses --help",
     "poses import -h", "poses export -h"],
)  # fmt: skip
def test_help_imports_nothing_heavy(words: str) -> None:
    """Under 0.3 s on a quiet machine; the test looks at what is imported, because seconds depend on the machine."""
    program = (
        "import sys\nfrom omnisyn_cli.cli import main\n"
        f"try:\n    main({words.split()})\n"
        "except SystemExit as left:\n    print(left.code, *sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    code, *modules = done.stderr.split()
    assert code == "0"
    assert not HEAVY & {module.partition(".")[0] for module in modules}
    assert done.stdout


def test_no_plugin_of_another_program_is_loaded(tmp_path: Path) -> None:
    """Looking for them takes as long as reading poses."""
    (tmp_path / "other-1.dist-info").mkdir()
    (tmp_path / "other-1.dist-info" / "METADATA").write_text("Name: other\nVersion: 1\n")
    (tmp_path / "other-1.dist-info" / "entry_points.txt").write_text("[pydantic]\nother = other\n")
    (tmp_path / "other.py").write_text("print('loaded')\n")
    command = [sys.executable, "-m", "omnisyn_cli", "models"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    environment.pop("PYDANTIC_DISABLE_PLUGINS", None)  # this process may have set it already
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert "loaded" not in done.stdout


def test_the_library_imports_without_torch_and_onnxruntime() -> None:
    """Interpolating needs neither; only networks do."""
    program = "import sys, omnisyn_cli.interpolation.run; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"torch", "onnxruntime", "click"} & set(done.stdout.split())


def test_every_command_is_listed_and_loads(omnisyn: Omnisyn) -> None:
    result = omnisyn("--help")
    for name, (_, line) in COMMANDS.items():
        assert f"  {name}" in result.out
        assert line.split()[0] in result.out
        command = cli.get_command(None, name)  # type: ignore[arg-type]
        assert command is not None
        assert command.name == name


@pytest.mark.parametrize("group", ["train", "poses", "scenes"])
def test_what_commands_do_is_listed_in_whole_sentences(omnisyn: Omnisyn, group: str) -> None:
    assert "..." not in omnisyn(group, "--help").out.partition("Commands:")[2]


def test_the_version_is_the_packages(omnisyn: Omnisyn) -> None:
    assert omnisyn_cli.__version__ in omnisyn("--version").out


@pytest.mark.parametrize(
    "arguments",
    [["nosuch"], ["interpolate"], ["interpolate", "--nosuch"],
     *(["interpolate", "a", "b", "--poses", "p", "-o", "o", *more] for more in (
         ["--size", "64x64"], ["--size", "²x1"], ["--size", "64"], ["--frames", "1"], ["--fps", "0"], ["--fps", "x"],
         ["--duration", "-1"], ["--codec", "h266"], ["--depth", "guess"], ["--threads", "0"], ["--cut", "0"],
         ["--heading", "north"], ["--ease", "bouncy"], ["--renderer", "magic"], ["--device", "tpu"]))],
)  # fmt: skip
def test_wrong_usage_is_2_and_says_so_on_stderr(omnisyn: Omnisyn, arguments: list[str]) -> None:
    omnisyn.misused(*arguments)


@pytest.mark.parametrize(
    "arguments",
    [["interpolate", "a", "b", "--poses", "p", "-o", ""], ["interpolate", "", "b", "--poses", "p", "-o", "o"],
     ["scenes", "make", ""], ["eval", "data", "--report", ""], ["batch", "jobs", "-o", ""]],
)  # fmt: skip
def test_an_empty_name_is_not_this_folder(
    omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str]
) -> None:
    """As of a variable that the shell has not set."""
    monkeypatch.chdir(tmp_path)
    assert "got an empty one" in omnisyn.misused(*arguments)
    assert listing(tmp_path) == {}


def test_the_remedy_is_that_of_the_mistake(omnisyn: Omnisyn, tmp_path: Path) -> None:
    estimate = ("poses", "estimate", "a.jpg", "b.jpg", "-o", "p.json")
    assert "got more than one; leave out" in omnisyn.misused(*estimate, "--baseline", 1, "--camera-height", 1.6)
    assert "got none; give one" in omnisyn.misused(*estimate)
    assert "or a flat 1920x1080, got '1080p'" in omnisyn.misused("interpolate", "a", "b", "--size", "1080p")
    assert "got a folder; name the files in it" in omnisyn.ended(3, "info", tmp_path).err
    assert "(omnisyn poses estimate)" in omnisyn.refused("batch", "plan", tmp_path, "-o", tmp_path / "jobs.jsonl")


def chained(error: Exception, cause: Exception) -> Exception:
    """An error during the handling of another."""
    error.__context__ = cause
    return error


RAISED = {
    "input": (InputError("expected x, got y"), 3, "omnisyn: expected x, got y\n"),
    "failure": (OmnisynError("expected x, got y"), 1, "omnisyn: expected x, got y\n"),
    "two lines": (InputError("a file\nwith a break: expected x"), 3, "omnisyn: a file with a break: expected x\n"),
    "memory": (MemoryError(), 1, "expected enough memory, got none; try a smaller --size"),
    "threads": (RuntimeError("can't start new thread"), 1, "expected enough memory, got 'can't start new thread'"),
    "locks": (chained(RuntimeError("lost"), RuntimeError("can't allocate lock")), 1, "got 'can't allocate lock'"),
    "libraries": (ImportError("x.so: failed to map segment from shared object"), 1, "expected enough memory"),
    "files": (OSError(24, "Too many open files"), 1, "got 'Too many open files'; allow more open files (ulimit -n)"),
    "disk": (OSError(28, "No space left on device"), 1, "got 'No space left on device'; free some space"),
    "nameless": (OSError(95, "Not supported"), 1, "expected the system to do what the work needs, got 'Not supported'"),
    "interrupt": (KeyboardInterrupt(), 130, "interrupted"),
}


@pytest.mark.parametrize("case", RAISED)
def test_errors_become_one_line_and_an_exit_code(omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    error, code, words = RAISED[case]

    monkeypatch.setattr(cli.get_command(None, "info"), "callback", Mock(side_effect=error))  # type: ignore[arg-type]
    assert words in omnisyn.refused("info", "a.jpg", code=code)
    told = json.loads(omnisyn.ended(code, "info", "a.jpg", "--json").out)
    assert told["exit_code"] == code
    assert words.strip().replace("\n", " ").removeprefix("omnisyn: ") in told["error"]


def every_command(group: click.Group, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The words of each command, groups included."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*words, name)
        if isinstance(command, click.Group):
            yield from every_command(command, (*words, name))


def test_exit_codes_are_said_by_every_command_and_by_the_documents(omnisyn: Omnisyn) -> None:
    """In the same words, so that they mean the same."""
    for words in ((), *every_command(cli), ("batch", "plan")):
        assert EXIT_CODES_LINE in " ".join(omnisyn.quiet(*words, "--help").out.split()), words
    table = (Path(__file__).parents[2] / "docs" / "stability.md").read_text(encoding="utf-8")
    for code, meaning in EXIT_CODES.items():
        assert f"- **{code} {meaning}**: " in table


def test_wrong_usage_is_json_for_whoever_wants_json(omnisyn: Omnisyn) -> None:
    told = json.loads(omnisyn.ended(2, "interpolate", "a.jpg", "b.jpg", "--json", "--frames", "x").out)
    assert told["exit_code"] == 2
    assert "--frames" in told["error"]
    assert omnisyn.ended(3, "info", "--", "--json").out == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no such device")
@pytest.mark.parametrize("words", ["models", "models --json", "info nosuch", "--nosuch", "nosuch --json"])
def test_a_full_disk_behind_the_output_is_no_traceback(tmp_path: Path, words: str) -> None:
    for stream in ("1", "2"):
        command = f'"$0" -m omnisyn_cli {words} {stream}>/dev/full'
        done = subprocess.run(
            ["/bin/sh", "-c", command, sys.executable], cwd=tmp_path, capture_output=True, check=False
        )
        assert done.returncode in (0, 1, 2, 3)
        assert b"Traceback" not in done.stderr
        assert b"Exception" not in done.stderr


def test_bugs_are_not_dressed_up(omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch) -> None:
    """What nobody foresaw keeps its traceback; hiding it would hide the way to its cause."""

    monkeypatch.setattr(cli.get_command(None, "info"), "callback", Mock(side_effect=ZeroDivisionError))  # type: ignore[arg-type]
    with pytest.raises(ZeroDivisionError):
        omnisyn("info", "a.jpg")


NOT_FINITE = [
    ("interpolate", "--cut"), ("interpolate", "--cut-metres"), ("interpolate", "--budget"),
    ("interpolate", "--baseline"), ("interpolate", "--duration"), ("interpolate", "--fps"), ("interpolate", "--nadir"),
    ("batch plan", "--max-baseline"),
    ("batch", "--gpus"), ("scenes make", "--baseline"), ("scenes make", "--tilt"), ("poses estimate", "--baseline"),
    ("poses import", "--time-tolerance"), ("train depth", "--rate"), ("train depth", "--minutes"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "option"), NOT_FINITE)
@pytest.mark.parametrize("number", ["nan", "inf", "-1"])
def test_numbers_that_mean_nothing_are_wrong_usage(omnisyn: Omnisyn, command: str, option: str, number: str) -> None:
    assert f"'{option}'" in omnisyn.misused(*command.split(), option, number)


def test_a_reader_that_leaves_is_no_crash(tmp_path: Path) -> None:
    images = write_pair(tmp_path)
    process = start_cli("info", *images * 20, folder=tmp_path)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    err = process.stderr.read().decode()
    process.stderr.close()
    assert process.wait(600) == 1
    assert "Traceback" not in err
    assert "Exception ignored" not in err


def test_what_the_system_refuses_is_named(omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "omnisyn_cli.interpolation.describe.describe_file",
        Mock(side_effect=PermissionError(13, "Permission denied", "some/folder")),
    )
    expected = "some/folder: expected a place that can be used, got 'Permission denied'; check its name and permissions"
    assert omnisyn.refused("info", "a.jpg", code=1) == f"omnisyn: {expected}\n"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell that closes streams")
@pytest.mark.parametrize("closing", ["2>&-", ">&-", "<&-", "<&- >&- 2>&-"])
def test_work_is_done_without_standard_streams(tmp_path: Path, closing: str) -> None:
    arguments = map(str, folder_arguments(tmp_path, write_pair(tmp_path)))
    program = [sys.executable, "-m", "omnisyn_cli", *arguments]
    done = subprocess.run(["/bin/sh", "-c", f'"$@" {closing}', "sh", *program], cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert len(list((tmp_path / "out").iterdir())) == 3


def test_names_that_no_terminal_can_show_do_not_stop_the_work(tmp_path: Path) -> None:
    folder = tmp_path / "ünï 日本"
    folder.mkdir()
    images = write_pair(folder)
    process = start_cli(*pair_arguments(folder, images, "out.mp4"), folder=tmp_path, PYTHONIOENCODING="ascii")
    out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    assert b"3 frames of 32x16" in out
    assert "out.mp4" in listing(folder)


COMMANDING_NAME = "a\x1b[31m\n\x9bred\u202egnp.jpg"
SPELLED_OUT = r"a\u001b[31m\u000a\u009bred\u202egnp.jpg"


@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
def test_names_command_no_terminal(tmp_path: Path, omnisyn: Omnisyn) -> None:
    """Escape sequences, line breaks and marks of direction are spelled out, wherever a name is printed."""
    named = tmp_path / COMMANDING_NAME
    text = omnisyn.ended(3, "info", named).err + omnisyn.misused(COMMANDING_NAME)
    text += omnisyn.refused("interpolate", named, named, "--poses", "auto")
    named.write_bytes(write_pair(tmp_path)[0].read_bytes())
    text += omnisyn.made("info", named).out.partition("\n")[0] + omnisyn.made("info", named, "--json").out
    assert json.loads(omnisyn.made("info", named, "--json").out)[0]["file"] == str(named)
    assert text.count(SPELLED_OUT) == 3  # and JSON, as JSON has it
    assert not {"\x1b", "\x9b", "\u202e"} & set(text)


def test_nothing_is_printed_but_by_what_spells_names_out() -> None:
    """``say`` prints lines; rich prints bars, and tables of what ``printable`` has been through."""
    for path in sorted(Path(omnisyn_cli.__file__).parent.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        assert path.name in ("terminal.py", "help.py") or "click.echo(" not in text, path
        assert "rich.table" not in text or "printable(" in text, path


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere file names are text")
def test_names_that_are_no_text_are_refused(tmp_path: Path, omnisyn: Omnisyn) -> None:
    images = write_pair(tmp_path)
    foreign = images[0].rename(tmp_path / "b\udcffroken.png")  # a byte that is not UTF-8
    assert "expected a file name in UTF-8" in omnisyn.refused(*pair_arguments(tmp_path, [foreign, images[1]]))

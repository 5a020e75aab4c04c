"""What the source code has to keep to, whatever it does: who imports whom, who touches files, what is exported."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import omnisyn_cli

ROOT = Path(omnisyn_cli.__file__).parent

# From the top to the bottom; what is in one set does not know each other.
LAYERS = (
    {"__main__"}, {"cli"}, {"training"}, {"evaluation"}, {"batch"}, {"interpolation"}, {"pipeline"}, {"baselines"},
    {"synthesis"}, {"poses"}, {"io", "networks", "runtime", "scenes", "stereo", "render", "fusion"}, {"types"},
    {"geometry"}, {"compute"}, {"errors"},
)  # fmt: skip
MOST_ENTRIES = 24  # In the package itself: more rooms than that and nobody finds the right one.
# Modules that may import torch at their top.
TORCH = (
    "omnisyn_cli.networks", "omnisyn_cli.training", "omnisyn_cli.evaluation",
    "omnisyn_cli.render.rasterize_torch",
)  # fmt: skip
ONNX = ("omnisyn_cli.runtime", "omnisyn_cli.networks", "omnisyn_cli.training")

# The only ones that open files: io, machine code, models, answers that are kept, checkpoints, records of a batch.
FILE_MODULES = (
    "omnisyn_cli.io", "omnisyn_cli.compute.kernel_files", "omnisyn_cli.poses.file", "omnisyn_cli.poses.formats",
    "omnisyn_cli.poses.entries", "omnisyn_cli.poses.tour_file", "omnisyn_cli.runtime.models",
    "omnisyn_cli.runtime.monocular_session", "omnisyn_cli.training", "omnisyn_cli.evaluation",
    "omnisyn_cli.interpolation.planning", "omnisyn_cli.interpolation.added_models", "omnisyn_cli.batch",
)  # fmt: skip
# Parts of the standard library that a command may import at its top.
LIGHT = {
    "atexit", "collections", "contextlib", "dataclasses", "errno", "functools", "gc", "importlib", "io", "itertools",
    "json", "math", "os", "pathlib", "shutil", "signal", "sys", "threading", "time", "types", "typing",
}  # fmt: skip
# The room that a command may import at its top: the names that users choose from. It imports the rest when asked.
LIGHT_ROOM = "pipeline"
FILE_CALLS = {
    "open", "read_text", "read_bytes", "write_text", "write_bytes", "imread", "imwrite", "fromfile", "tofile", "savez",
    "unlink", "rmtree", "mkdir", "rmdir", "touch",
}  # fmt: skip


@dataclass(frozen=True)
class Module:
    name: str
    tree: ast.Module

    @property
    def part(self) -> str:
        """The layer's member it belongs to: the first name below the package."""
        return [*self.name.split("."), ""][1]

    def is_in(self, names: tuple[str, ...]) -> bool:
        return any(self.name == name or self.name.startswith(name + ".") for name in names)

    def imports(self, nodes: Iterator[ast.AST] | None = None) -> Iterator[tuple[str, str]]:
        """All ``(module, name)`` that are imported anywhere but for type checkers; ``name`` may be empty."""
        for node in nodes or running_nodes(self.tree):
            if isinstance(node, ast.Import):
                yield from ((alias.name, "") for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{self.name}: relative import"
                yield from ((node.module or "", alias.name) for alias in node.names)

    def exported(self) -> set[str]:
        """The names in ``__all__``, or without it those that the module makes itself and does not hide."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and any(
                isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets
            ):
                return set(ast.literal_eval(node.value))
        own = [node for node in self.tree.body if not isinstance(node, (ast.Import, ast.ImportFrom))]
        return {name for name in top_names(own) if not name.startswith("_")}

    def defined(self) -> set[str]:
        """Names that exist at its top level, but for those of type checkers."""
        return set(top_names(self.tree.body))


def running_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes below ``tree`` outside of ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from running_nodes(node)


def top_names(body: list[ast.stmt]) -> Iterator[str]:
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            yield from (alias.asname or alias.name for alias in node.names)
        elif isinstance(node, (ast.If, ast.Try)):
            yield from top_names(node.body)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name))


def modules() -> Iterator[Module]:
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        yield Module(name, ast.parse(path.read_text(encoding="utf-8")))


MODULES = {module.name: module for module in modules()}
every_module = pytest.mark.parametrize("module", MODULES.values(), ids=MODULES)


def rank(name: str) -> int:
    return next(level for level, rooms in enumerate(LAYERS) if name.split(".")[1] in rooms)


@every_module
def test_imports_point_downwards_and_islands_do_not_know_each_other(module: Module) -> None:
    if not module.part:
        assert {name.partition(".")[0] for name, _ in module.imports()} <= {"__future__"} | LIGHT
        return
    for package, what in module.imports():
        name = f"{package}.{what}" if f"{package}.{what}" in MODULES else package
        if name.startswith("omnisyn_cli."):
            is_deeper = rank(name) > rank(module.name)
            is_own = rank(name) == rank(module.name) and name.split(".")[1] == module.part
            assert is_deeper or is_own, f"{module.name} imports {name}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Not even for type checkers: what two modules need of each other belongs into a third."""
    needs = {
        name: {
            f"{package}.{what}" if f"{package}.{what}" in MODULES else package
            for package, what in module.imports(ast.walk(module.tree))
        }
        & MODULES.keys() - {"omnisyn_cli"}
        for name, module in MODULES.items()
        if module.part
    }
    while free := {name for name, needed in needs.items() if not needed & needs.keys()}:
        needs = {name: needed for name, needed in needs.items() if name not in free}
    assert not needs, sorted(needs)


def test_the_package_has_few_rooms() -> None:
    entries = [entry.name for entry in ROOT.iterdir() if entry.is_file() or any(entry.rglob("*.py"))]
    assert len(entries) <= MOST_ENTRIES, sorted(entries)


@every_module
def test_heavy_and_foreign_packages_stay_where_they_belong(module: Module) -> None:
    foreign = {name.partition(".")[0] for name, _ in module.imports()}
    at_the_top = {name.partition(".")[0] for name, _ in module.imports(iter(module.tree.body))}
    assert "torch" not in at_the_top or module.is_in(TORCH)
    assert not foreign & {"onnxruntime", "onnx"} or module.is_in(ONNX)
    assert not foreign & {"click", "rich"} or module.part == "cli"
    assert not foreign & {"OpenImageIO", "ffmpeg", "imageio_ffmpeg"} or module.part == "io"
    assert "pydantic" not in foreign or module.is_in(FILE_MODULES)
    if module.part in {"geometry", "runtime", "io", "poses", "stereo", "fusion", "scenes"}:
        assert "torch" not in foreign
    if module.part == LIGHT_ROOM:
        assert at_the_top <= {"__future__", "omnisyn_cli"} | LIGHT, f"{module.name} is slow to import"
    if module.part == "cli":
        assert at_the_top <= {"__future__", "click", "omnisyn_cli"} | LIGHT, f"{module.name} is slow to import"


@every_module
def test_commands_import_the_library_when_they_are_called(module: Module) -> None:
    """At the top of a command only what is light: its own package, the errors, the names to choose from."""
    if module.part in {"cli", LIGHT_ROOM}:
        for name, _ in module.imports(iter(module.tree.body)):
            if name.startswith("omnisyn_cli."):
                is_light = name.split(".")[1] in {"cli", "errors", LIGHT_ROOM}
                assert is_light, f"{module.name} imports {name}"


@every_module
def test_only_io_touches_files(module: Module) -> None:
    if module.is_in((*FILE_MODULES, "omnisyn_cli.cli")):
        return
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            assert called not in FILE_CALLS, f"{module.name}:{node.lineno} calls {called}"


@every_module
def test_nothing_is_printed_asserted_or_exited_in_the_library(module: Module) -> None:
    for node in ast.walk(module.tree):
        assert not isinstance(node, ast.Assert), f"{module.name}:{node.lineno} asserts"
        assert not isinstance(node, ast.ExceptHandler) or node.type is not None, (
            f"{module.name}:{node.lineno} bare except"
        )
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {"print", "exit", "quit", "breakpoint"}, f"{module.name}:{node.lineno}"
            assert called != "sys.exit" or module.part == "cli", f"{module.name}:{node.lineno}"


@every_module
def test_what_is_exported_exists_and_what_other_rooms_take_is_exported(module: Module) -> None:
    """What a module imports for itself, or hides by an underscore, is nothing to other rooms."""
    if module.name == "omnisyn_cli":
        return
    assert module.exported() <= module.defined(), f"{module.name}: {module.exported() - module.defined()}"
    for name, what in module.imports():
        other = MODULES.get(name)
        if other is not None and f"{name}.{what}" not in MODULES and other.name != "omnisyn_cli":
            assert other.part == module.part or what in other.exported(), (
                f"{module.name}: {name} does not export {what}"
            )


@every_module
def test_every_module_says_what_it_is_for(module: Module) -> None:
    docstring = ast.get_docstring(module.tree)
    assert docstring
    assert docstring.splitlines()[0].endswith((".", "?", ":")) or "\n\n" in docstring or len(docstring) > 40


def test_half_a_pixel_has_one_home() -> None:
    """Angles of pixels are computed in ``geometry`` and in kernels that state them; nowhere else a π meets a width."""
    for module in MODULES.values():
        if module.part in {"geometry", "compute", "render", "stereo", "scenes", "networks", "training", "baselines"}:
            continue
        names = {ast.unparse(node) for node in ast.walk(module.tree) if isinstance(node, ast.Attribute)}
        assert not names & {"math.pi", "np.pi", "numpy.pi"}, module.name

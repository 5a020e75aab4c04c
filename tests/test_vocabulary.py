"""The words of the code: terms of the field, nouns for constants, telling file names, arguments that are explained.

Each check lists its offenders as ``file:line: message``.
"""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

import omnisyn_cli

ROOT = Path(omnisyn_cli.__file__).parent
LEARNED = "fusion networks runtime training"  # Rooms where a plane would be a channel of an array.
# Words that this code once used for itself: the field's term, and the rooms where the word means that (none: all).
PRIVATE_WORDS = {
    "agreed": ("consistent", "stereo fusion networks runtime training types"), "among": ("detect", "fusion"),
    "around": ("encode", "networks"), "as told": ("noisy pose", ""), "ask": ("queries and keys", "networks"),
    "asked panorama": ("source-view sampler", ""), "at crossings": ("grid subsample", ""), "back": ("second", "stereo"),
    "bands": ("disparity ranges", "stereo"), "belief": ("confidence", ""), "beyond zero": ("clamped error", ""),
    "corrects": ("residual", ""), "counted": ("fixed point", "stereo"), "cut off": ("clipped", ""),
    "doubt": ("uncertainty", "stereo fusion networks runtime synthesis pipeline training"),
    "doubted": ("uncertain", ""), "doubting": ("uncertain", ""), "evidence": ("stereo features", ""),
    "exchanged": ("swapped", ""), "fades": ("baselines", "synthesis pipeline"),
    "finding": ("depth stage", "interpolation"), "greatest near": ("dilate, window maximum", ""),
    "greatest of parts": ("max pool", ""), "held askew": ("random rotation", ""),
    "hold": ("align", "runtime baselines"), "joined": ("fused", "synthesis pipeline"),
    "jump": ("P2, penalty", "stereo"), "keeping": ("footprint", "interpolation"),
    "know samples": ("prefill visibility", ""), "lead": ("uniqueness margin", "stereo"),
    "leap": ("adaptive P2", "stereo"), "leaping": ("adaptive P2", "stereo"),
    "look": ("skip connection, candidate", "fusion networks training"), "looked at": ("detect", ""),
    "looks": ("number of layers", "networks"), "making": ("factory", ""), "mean near": ("box filter", ""),
    "meridians": ("epipolar grid", ""), "middle of": ("center subsample", "stereo synthesis"),
    "middles": ("center subsample", "stereo synthesis"), "near": ("relative bias", "networks"),
    "onwards": ("epipole direction", ""), "opinion": ("pair depth", ""), "painting": ("direct fusion", ""),
    "paints": ("direct", ""), "papering": ("photo textures", ""), "parts": ("fixed-point scale", "stereo"),
    "passing": ("frame stage", "interpolation"), "plane": ("channel", LEARNED), "planes": ("channels", LEARNED),
    "pool": ("data set, shards", "training"), "recipe": ("config", "interpolation pipeline evaluation batch synthesis"),
    "rehearsal": ("kernel warm-up", ""), "rehearsed": ("kernel warm-up", ""),
    "root": ("square root of inverse depth", f"stereo render synthesis types {LEARNED}"),
    "roots": ("square roots of inverse depth", f"stereo render synthesis types {LEARNED}"),
    "second look": ("warp candidates", ""), "segments": ("pair", "synthesis pipeline"),
    "spot": ("edge pixel", "stereo render fusion synthesis pipeline types"),
    "spots": ("edge pixels", "stereo render fusion synthesis pipeline types"), "spread": ("expand", "networks"),
    "stored": ("quantized", "fusion"), "storing": ("quantization", ""), "suppose": ("hypothesis", ""),
    "supposed": ("hypothesis", ""), "suppressed": ("detect", "fusion"), "sure": ("valid", ""),
    "surprise": ("log loss", ""), "take": ("projection", "networks"), "telltales": ("required arrays", ""),
    "there": ("first, forward", "stereo"), "think": ("MLP", "networks"), "told": ("prediction", "fusion training"),
    "tour": ("chain", "stereo synthesis pipeline"), "tours": ("chain", "stereo synthesis pipeline"),
    "trust": ("confidence", ""), "usual": ("default", ""), "walk": ("web viewer", "interpolation"),
    "ways": ("pair stops", "training"), "witness": ("source-view sampler", ""),
    "witnesses": ("source-view samplers", ""), "workshop": ("staging folder", ""),
}  # fmt: skip
# Whole names, whose words are fine in others.
PRIVATE_NAMES = {
    "Bands": "DisparityRange", "Recent": "LRU cache", "Rendering": "Layer", "Shown": "Layer", "Turned": "local frame",
    "Views": "LayerPair",
}  # fmt: skip
# Names in which a private word has its common meaning.
COMMON_NAMES = {
    "BrokenProcessPool", "ProcessPoolExecutor", "ThreadPoolExecutor",  # of the standard library
    "avg_pool2d", "max_pool", "max_pool2d",
    "fill_with_planes",  # of geometry
    "look_up", "look_up_rows", "looked_up",
    "pool", "pools", "validation_pool",  # of `train pool` and `--pool`: a folder of scenes to learn from
    "run_bands",
    "take_along_axis",
}  # fmt: skip
# Adjectives, adverbs, numbers and prepositions that cannot name a constant by themselves.
NOT_NOUNS = {
    "ABOVE", "ABSURD", "ACROSS", "AHEAD", "ALL", "ALMOST", "ALONE", "ALONG", "ALWAYS", "ANY", "APART", "AROUND",
    "ASIDE", "AT", "BEHIND", "BELOW", "BESIDE", "BEST", "BETWEEN", "BEYOND", "BIG", "BLIND", "BRIGHT", "BY", "CERTAIN",
    "CLOCKWISE", "CLOSE", "COARSE", "DARK", "DEEP", "DENSE", "DIFFERENT", "DRAWN", "ELSEWHERE", "EMPTY", "ENOUGH",
    "EQUAL", "EVERY", "EVERYWHERE", "EXACT", "FAINT", "FAR", "FARTHER", "FAST", "FEW", "FINE", "FINER", "FIRST", "FIT",
    "FITS", "FLAT", "FORMER", "FREE", "FROM", "FULL", "FURTHER", "FUZZY", "GLASSY", "GOLDEN", "GREAT", "HALF", "HEAVY",
    "HIGH", "HIGHER", "IN", "INDISTINGUISHABLE", "INFINITE", "INWARD", "LARGE", "LARGER", "LAST", "LATE", "LATER",
    "LESS", "LIGHT", "LINEAR", "LITTLE", "LONG", "LOOSE", "LOW", "LOWER", "MANY", "MINOR", "MORE", "MUCH", "MULTIPLE",
    "NARROW", "NEAR", "NEARBY", "NEVER", "NO", "NONE", "NOT", "NOTHING", "NOWHERE", "OF", "OFTEN", "ON", "ONCE", "ONE",
    "ONLY", "OPEN", "OTHER", "OUTSIDE", "OUTWARD", "OWN", "PANORAMIC", "PLAIN", "PLANAR", "POOR", "QUICK", "RARE",
    "REAL", "ROUGH", "SAME", "SECOND", "SEEN", "SELDOM", "SEVERAL", "SHARP", "SHORT", "SHORTER", "SIGNIFICANT",
    "SIMILAR", "SINGULAR", "SLIGHT", "SLOW", "SMALL", "SMALLER", "SOME", "SPARSE", "SPECIAL", "SPHERICAL", "STEEP",
    "STILL", "STRAIGHT", "STRICT", "STRONG", "SUFFICIENT", "SURE", "TALL", "THE", "THICK", "THIN", "THIRD", "TIGHT",
    "TINY", "TO", "TOGETHER", "TOO", "TRUE", "TWICE", "UNDER", "UNKNOWN", "UNLIKE", "UNSEEN", "UPRIGHT", "USUAL",
    "VAGUE", "WEAK", "WHOLE", "WIDE", "WITH", "WITHIN", "WITHOUT", "WORSE", "WORST",
}  # fmt: skip
# What :data:`NOT_A_NOUN` mistakes for something else.
NOUNS = {
    "CUBED", "EMBED", "FORWARD", "MANIFEST", "RED", "SEED", "SPEED", "CHEST", "REQUEST", "TEST", "TABLE", "VARIABLE",
}  # fmt: skip
# Endings of participles, superlatives and other adjectives.
NOT_A_NOUN = re.compile(r"\w+(ED|EST|ABLE|IBLE|LESS|FUL|OUS|WARD)")
# Forms that say what happens, not what a value is; others, such as MATCHING, name a method.
GERUNDS = {"COMPILING", "CORRECTING", "DIFFERING", "DOUBTING", "FINDING", "HALVING", "PASSING", "SPREADING", "WAITING"}
BOUND = re.compile(r"_?(LEAST|MOST|GREATEST)(_|$)")  # What has to be called MIN or MAX.
MAX_SHARED_FILE_NAMES = 8
MIN_EXPLAINED_SHARE = 0.97
MAX_PARAMETERS = 8

# Decorators of compiled functions, whose parameters have no types.
KERNELS = {
    "compiled_kernel", "fast_kernel", "fast_subkernel", "inlined", "inlined_contracting", "kernel", "njit", "subkernel",
}  # fmt: skip


@cache
def sources() -> dict[Path, str]:
    """All modules of the package by their path in it."""
    return {path.relative_to(ROOT): path.read_text(encoding="utf-8") for path in sorted(ROOT.rglob("*.py"))}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(sources()[path])


def words_of(name: str) -> list[str]:
    """The words of an identifier, in lower case: ``is_CutOff2`` has is, cut, off."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def identifiers(path: Path) -> Iterator[tuple[int, str]]:
    """The first line of every name that a module uses, and that of its file and folder."""
    yield from ((1, part) for part in path.with_suffix("").parts)
    seen = set()
    for token in tokenize.generate_tokens(io.StringIO(sources()[path]).readline):
        if token.type == tokenize.NAME and token.string not in seen:
            seen.add(token.string)
            yield token.start[0], token.string


def terms_for(name: str, room: str) -> Iterator[str]:
    """Of each private word in an identifier, what to say instead."""
    if name.strip("_") in COMMON_NAMES:
        return
    if name.strip("_") in PRIVATE_NAMES:
        yield PRIVATE_NAMES[name.strip("_")]
    phrase = f" {' '.join(words_of(name))} "
    for word, (term, rooms) in PRIVATE_WORDS.items():
        if f" {word} " in phrase and (not rooms or room in rooms.split()):
            yield f"{term}, not {word!r}"


def private_names() -> Iterator[str]:
    for path in sources():
        room = path.parts[0].removesuffix(".py")
        for line, name in identifiers(path):
            yield from (f"{path}:{line}: {name}: {term}" for term in terms_for(name, room))


def constants(path: Path) -> Iterator[tuple[ast.stmt, str]]:
    for node in tree_of(path).body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for name in (name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)):
                if re.fullmatch(r"_?[A-Z][A-Z0-9_]+", name.id):
                    yield node, name.id


def is_noun(word: str) -> bool:
    return word in NOUNS or not (word in NOT_NOUNS or word in GERUNDS or NOT_A_NOUN.fullmatch(word))


def bare_constants() -> Iterator[str]:
    """Constants without a noun, and bounds that are not MIN or MAX."""
    for path in sources():
        for node, name in constants(path):
            if not any(map(is_noun, name.strip("_").split("_"))):
                yield f"{path}:{node.lineno}: {name}: a noun is missing"
            elif BOUND.match(name):
                yield f"{path}:{node.lineno}: {name}: MIN_… or MAX_…"


def is_explained(lines: list[str], statement: ast.stmt, following: ast.stmt | None) -> bool:
    """Whether a constant has a string below it, a comment above it, or one on its lines."""
    own = lines[statement.lineno - 1 : statement.end_lineno]
    above = lines[statement.lineno - 2].strip() if statement.lineno > 1 else ""
    has_string = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
    return has_string or above.startswith("#") or any(" # " in line for line in own)


def unexplained_constants() -> tuple[list[str], int]:
    """Constants that nothing is said of, and the number of all; lines without a gap are explained together."""
    offenders, count = [], 0
    for path, text in sources().items():
        lines, body = text.splitlines(), tree_of(path).body
        explained: dict[int, bool] = {}
        for index in reversed(range(len(body))):
            following = body[index + 1] if index + 1 < len(body) else None
            is_next = following is not None and following.lineno == (body[index].end_lineno or 0) + 1
            explained[id(body[index])] = is_explained(lines, body[index], following) or (
                is_next and explained[id(following)] and isinstance(following, (ast.Assign, ast.AnnAssign))
            )
        for index, node in enumerate(body[1:], 1):  # a comment above a group is one of all its lines
            before = body[index - 1]
            if isinstance(before, (ast.Assign, ast.AnnAssign)) and node.lineno == (before.end_lineno or 0) + 1:
                explained[id(node)] |= explained[id(before)]
        for node, name in constants(path):
            count += 1
            if not explained[id(node)]:
                offenders.append(f"{path}:{node.lineno}: {name}: unit and origin?")
    return offenders, count


def decorator_of(node: ast.expr) -> str:
    function = node.func if isinstance(node, ast.Call) else node
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def unexplained_kernels() -> Iterator[str]:
    for path in sources():
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef) and KERNELS & set(map(decorator_of, node.decorator_list)):
                names = [each.arg for each in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]
                unsaid = set(names) - set(re.findall(r"\w+", ast.get_docstring(node) or ""))
                if len(names) > MAX_PARAMETERS and unsaid:
                    yield f"{path}:{node.lineno}: {node.name}: nothing about {', '.join(sorted(unsaid))}"


def fail_with(offenders: list[str]) -> str:
    return "\n".join([f"{len(offenders)}:", *offenders])


@pytest.mark.parametrize("rule", [private_names, bare_constants, unexplained_kernels])
def test_names_are_terms_constants_are_nouns_and_kernels_are_explained(rule: Callable[[], Iterator[str]]) -> None:
    offenders = list(rule())
    assert not offenders, fail_with(offenders)


def test_few_files_share_a_name() -> None:
    counts = Counter(path.name for path in sources() if not path.name.startswith("__"))
    names = sorted(name for name, count in counts.items() if count > 1)
    assert len(names) <= MAX_SHARED_FILE_NAMES, names


def test_constants_say_where_they_come_from() -> None:
    offenders, count = unexplained_constants()
    assert len(offenders) <= (1.0 - MIN_EXPLAINED_SHARE) * count, fail_with(offenders)

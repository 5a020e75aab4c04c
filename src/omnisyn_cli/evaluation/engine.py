"""All methods on all pairs of a data set, one unit of work after the other, each written down when it is finished.

Interrupted and started again, a run goes on where it was: units whose inputs, options and program are those of a line
in ``results.jsonl`` are not done again. What is broken or unavailable is tried again, for it may have been repaired.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.layouts import still_region_of, tours_of_photographs
from omnisyn_cli.evaluation.datasets.sources import (
    AROUND_PAIRS,
    NoScaleError,
    Pair,
    SceneSource,
    choose_pairs,
    in_tours,
)
from omnisyn_cli.evaluation.grouping import BOUND, median_depth
from omnisyn_cli.evaluation.measure import measure
from omnisyn_cli.evaluation.methods import (
    PHOTOGRAPH_METHODS,
    ComparedMethod,
    MethodAtWork,
    MethodUnavailableError,
    PairDepths,
    find_methods,
)
from omnisyn_cli.evaluation.results import RESULTS_NAME, Fingerprints, Status, UnitRecord, read_records, worst_frames
from omnisyn_cli.evaluation.views import LoadedPair, load_pair
from omnisyn_cli.evaluation.visualization import PictureWriter, has_all_pictures
from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.io.documents import append_line
from omnisyn_cli.io.outputs import make_folder

KnownRecords = dict[tuple[str, str, str, str], UnitRecord]  # The last record of every unit.


@dataclass(frozen=True)
class EvaluationJob:
    """What a user asks for."""

    dataset: Path  # folder of scenes, or a scene
    report: Path  # folder for results and pictures; made if it is not there
    methods: str = "usual"  # ``usual``, ``all`` or names separated by commas, see :mod:`omnisyn_cli.evaluation.methods`
    layout: str = "auto"  # of the data set, a key of :data:`omnisyn_cli.evaluation.datasets.FORMATS` or ``auto``
    pairs: str | None = None  # which frames are inputs, see :mod:`omnisyn_cli.evaluation.datasets.sources`
    size: tuple[int, int] | None = None  # (height, width) of the comparison; None means that of the true frames
    pictures: bool = True  # keep frames, error maps and depth as pictures
    device: str = "auto"  # where networks run
    threads: int | None = None  # at most this many; None is one per core
    allow_outside: bool = False  # accept depth and masks that ``poses.json`` names outside of its folder
    # photographs of tours: each is the truth between its neighbours, unless ``pairs`` names others
    leave_out: bool = False
    command: str = "from Python"  # that asked for all this, as the report says


@dataclass(frozen=True)
class EvaluationPlan:
    """A job with the pairs and methods it is about."""

    job: EvaluationJob  # what was asked for
    methods: tuple[ComparedMethod, ...]  # to be compared
    pairs: tuple[Pair, ...]  # to be made; those without true frames have a frame half way
    findings: tuple[UnitRecord, ...]  # records of scenes that cannot be evaluated, with the reason

    @property
    def units(self) -> int:
        """The number of units of work."""
        return len(self.methods) * len(self.pairs)


def plan_evaluation(job: EvaluationJob) -> EvaluationPlan:
    """Read all poses, no picture; InputError: no scenes, no such method, unclear or absent pairs, a size not 2:1."""
    if job.size is not None and job.size[1] != 2 * job.size[0]:
        raise InputError(f"expected a size twice as wide as high, got {job.size[1]}x{job.size[0]}; correct it")
    if job.leave_out and job.layout != "auto":
        raise InputError("expected --leave-out alone, got --format with it; leave one of them out")
    methods = find_methods(job.methods)
    has_tours = any(method.is_in_tour for method in methods)
    choose = choose_pairs(job.pairs or (AROUND_PAIRS if job.leave_out else None))
    if job.leave_out:
        sources = tours_of_photographs(job.dataset, choose, job.report, job.threads, allow_outside=job.allow_outside)
        choose = choose_pairs(None)
    else:
        sources = find_scenes(job.dataset, job.layout, allow_outside=job.allow_outside)
    pairs: list[Pair] = []
    findings: list[UnitRecord] = []
    for source in sources:
        try:
            found = in_tours(choose(source.read())) if has_tours else choose(source.read())
        except NoScaleError as error:
            findings.append(_finding(source, "skipped", str(error)))
        except Exception as error:  # noqa: BLE001 - one broken scene must not end an evaluation of many
            findings.append(_finding(source, "failed", one_line(error)))
        else:
            pairs += found
            if not found and (job.pairs is None or not Path(job.pairs).is_file()):
                findings.append(_finding(source, "skipped", "expected panoramas enough for a pair, got fewer"))
    if not pairs and not findings:
        raise InputError(f"{job.pairs}: expected pairs of the scenes in {job.dataset}, got none; check the names")
    if job.methods == "usual" and job.leave_out:
        methods = find_methods(",".join(PHOTOGRAPH_METHODS))
    elif job.methods == "usual" and not any(pair.first.depth and pair.second.depth for pair in pairs):
        methods = [method for method in methods if method.name != BOUND]
    return EvaluationPlan(job, tuple(methods), tuple(pairs), tuple(findings))


def _finding(source: SceneSource, status: Status, reason: str) -> UnitRecord:
    return UnitRecord("", source.name, "", "", "", status, reason)


def evaluate(
    plan: EvaluationPlan, on_unit: Callable[[int, UnitRecord], None] | None = None, *, has_report: bool = True
) -> list[UnitRecord]:
    """Do what is not done yet; the records of everything, pair by pair, and of what could not be evaluated.

    Their report is written at the end, and after an interruption as well. ``on_unit`` gets the number of finished units
    and the last record. InputError: unreadable earlier results; OutputPathError, WriteError: the folder of the report
    cannot be written.
    """
    folder, records, units = plan.job.report, list[UnitRecord](), 0
    make_folder(folder, "the report")
    known = {record.unit: record for record in read_records(folder)}
    worker = _UnitRunner(plan.job)
    try:
        for record in chain(plan.findings, *(worker.records(pair, plan.methods, known) for pair in plan.pairs)):
            former = known.get(record.unit)
            if former is None or former.to_json() != record.to_json():  # as JSON undefined numbers are equal
                append_line(folder / RESULTS_NAME, record.to_json())
                known[record.unit] = record
            records.append(record)
            units += bool(record.method)
            if on_unit and record.method:
                on_unit(units, record)
    finally:
        if records and has_report:
            from omnisyn_cli.evaluation.report import write_report  # matplotlib takes a while to import

            write_report(folder, records, {"data set": str(plan.job.dataset), "command": plan.job.command})
    return records


class _UnitRunner:
    """Does units of work; holds the pictures of one pair."""

    def __init__(self, job: EvaluationJob) -> None:
        self._job, self._fingerprints = job, Fingerprints()
        self._still = cache(still_region_of)
        self._options: dict[str, Any] = {
            "size": job.size, "pictures": job.pictures, "device": job.device, "leave_out": job.leave_out,
        }  # fmt: skip

    def records(self, pair: Pair, methods: tuple[ComparedMethod, ...], known: KnownRecords) -> Iterator[UnitRecord]:
        """One record for every method, the known one where nothing has changed."""
        loaded: LoadedPair | str | None = None
        depths = PairDepths()
        baseline = distance_between(pair.first.pose, pair.second.pose)
        for method in methods:
            blank = UnitRecord(
                "", pair.scene, pair.first.name, pair.second.name, method.name, "failed", baseline=baseline
            )
            try:
                ingredients = [method.name, *method.ingredients()]
                method_pair = pair if method.is_in_tour else replace(pair, before=None, after=None)
                blank = replace(blank, key=self._fingerprints.of(method_pair, ingredients, self._options))
            except InputError as error:
                yield replace(blank, reason=one_line(error))
                continue
            former = known.get(blank.unit)
            is_done = former is not None and former.key == blank.key and former.status == "done"
            if former is not None and is_done and has_all_pictures(self._job.report, former):
                yield former
                continue
            loaded = loaded or self._loaded(pair)
            if isinstance(loaded, str):
                yield replace(blank, reason=loaded)
            else:
                yield self._unit(blank, pair, loaded, method, depths)

    def _loaded(self, pair: Pair) -> LoadedPair | str:
        """The pictures of a pair, or why there are none."""
        try:
            still = self._still(pair.first.image.parent) if self._job.leave_out else None
            return load_pair(pair, self._job.size, self._job.threads, are_photographs=self._job.leave_out, still=still)
        except Exception as error:  # noqa: BLE001 - one broken pair must not end an evaluation of many
            return one_line(error)

    def _unit(
        self, blank: UnitRecord, pair: Pair, loaded: LoadedPair, method: ComparedMethod, depths: PairDepths
    ) -> UnitRecord:
        """Measure one method; whatever breaks in it is written down, and the others go on."""
        try:
            threads, device = self._job.threads, self._job.device
            at_work = MethodAtWork(
                method, loaded.views, threads=threads, device=device, known=depths, around=loaded.around,
                still=loaded.still,
            )  # fmt: skip
            made = measure(at_work, loaded, (blank.first, blank.second), threads)
        except MethodUnavailableError as error:
            return replace(blank, status="unavailable", reason=one_line(error))
        except Exception as error:  # noqa: BLE001 - one broken method must not end a comparison of many
            return replace(blank, reason=one_line(error))
        frames, of_views = made.frames, made.depths
        if self._job.pictures:
            writer = PictureWriter(self._job.report, pair, blank.method)
            frames, of_views = writer.frames(loaded, made), writer.depths(loaded, made)
        known = loaded.views[0].known_depth
        if known is None and loaded.are_photographs and made.found is not None:  # whose true depth nobody knows
            known = made.found[0]
        depth = None if known is None else median_depth(known.inverse_depth)
        return replace(
            blank, status="done", size=loaded.size, median_depth=depth, frames=frames,
            depths=of_views, temporal=made.temporal, seconds=made.seconds, worst=worst_frames(frames),
        )  # fmt: skip


def one_line(error: Exception) -> str:
    """The message of an error; for those that this package did not expect, with their kind."""
    text = " ".join(str(error).split())
    return text if isinstance(error, OmnisynError) else f"{type(error).__name__}: {text}"

"""Every reader against damaged files: python -m benchmarks fuzz --minutes N [--reader NAME].

Files of every kind are mutated (mutations.py) and given to the commands that read them (attacked.py). Whatever comes,
a command ends in time, takes no more than a gigabyte, says what is wrong in one sentence, writes where it was told
to, and lets nothing through to the terminal. What is found is printed with its case, kept in fuzz-findings/ with the
damaged file, and made again with --case 'READER:NUMBER'. Cases that once found something are in fuzz_cases.txt and
are run first.
"""

import argparse
import json
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from random import Random, SystemRandom
from typing import Any

import numpy as np
from attacked import READERS, Reader, lay_out, make_whole

from quadrig.io.commands.main import run

ROOT = Path(__file__).resolve().parents[1]
CASES = Path(__file__).with_name("fuzz_cases.txt")
FINDINGS = Path("fuzz-findings")
# Beyond what the pictures here need, which is a megabyte.
MOST_BYTES = 1 << 30
# s of one processor; and by the clock, after which a process is taken for one that hangs.
SLOW, HANGS = 20, 120
# Longer is no sentence that a person reads.
LONGEST_SENTENCE = 2500

_CODES = {0, 1, 2, 3}
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
_TOLD = ("unexpected error", "Traceback (most recent call last)", "Exception ignored in")
_NOISE = re.compile(r"^(\[ ?(WARN|ERROR|INFO)|\[\w+ @ 0x|.*\w+Warning:)", re.MULTILINE)


# The process that is attacked.


def serve(folder: Path, answers: int) -> None:
    """Run the cases that come on standard input, one a line; answer each with a line of JSON to this descriptor."""
    whole, work = folder / "whole", folder / "work"
    make_whole(whole, work)
    clean = _numbers(whole / "rig.mcap")
    os.write(answers, b'"ready"\n')
    for line in sys.stdin:
        name, number = line.rstrip("\n").rsplit(":", 1)
        os.write(answers, json.dumps(_attack(READERS[name], f"{name}:{number}", whole, work, clean)).encode() + b"\n")


def _attack(reader: Reader, case: str, whole: Path, work: Path, clean: list[Any]) -> dict[str, Any]:
    """One case: what was run, how it ended, and what is wrong with that, or ""."""
    draw = Random(case)
    lay_out(whole, work, reader.needs)
    files = sorted(file for pattern in reader.damaged for file in work.glob(pattern) if file.is_file())
    damaged = draw.choice(files)
    damaged.write_bytes(reader.mutate(damaged.read_bytes(), draw))
    here = {"folder": damaged.parent.relative_to(work), "name": damaged.stem}
    command = draw.choice(reader.commands).format(str(damaged.relative_to(work)), **here)
    before = _listing(work)
    peak, began = _reset_peak(), time.process_time()
    with chdir(work), _captured(work.parent) as said:
        code = _run(command.split())
    seconds, grown = time.process_time() - began, _peak() - peak
    wrong = _wrong(code, said, seconds, grown) or _misplaced(before, _listing(work), damaged.relative_to(work))
    if not wrong and reader.unchanged and (code != 0 or _numbers(work / "kept/rig.mcap") != clean):
        wrong = "another result than that of the whole file"
    return {"command": command, "file": str(damaged), "code": code, "wrong": wrong, "said": said[1][-3000:]}


def _run(words: list[str]) -> int | str:
    try:
        return run(words)
    except BaseException as error:
        return f"{type(error).__name__}: {error}"


@contextmanager
def _captured(folder: Path) -> Iterator[list[str]]:
    """What is written to stdout and stderr meanwhile, by libraries too."""
    said: list[str] = []
    kept = [os.dup(descriptor) for descriptor in (1, 2)]
    files = [(folder / name).open("w+b") for name in ("stdout", "stderr")]
    for descriptor, file in zip((1, 2), files, strict=True):
        os.dup2(file.fileno(), descriptor)
    try:
        yield said
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for descriptor, file, old in zip((1, 2), files, kept, strict=True):
            os.dup2(old, descriptor)
            os.close(old)
            file.seek(0)
            said.append(file.read().decode("utf-8", "replace"))
            file.close()


def _wrong(code: int | str, said: list[str], seconds: float, grown: int) -> str:
    out, err = said
    if code not in _CODES:
        return f"ended with {code}"
    for words in _TOLD:
        if words in err:
            return f"{words}: {err.strip().splitlines()[-1][:300]}"
    if found := _UNSAFE.search(out) or _UNSAFE.search(err):
        return f"lets {found[0]!r} through to the terminal"
    if found := _NOISE.search(err) or _NOISE.search(out):
        return f"noise of a library: {found.string[found.start() : found.start() + 200]!r}"
    if code == 1 and not any(line.startswith("rig: ") for line in err.splitlines()):
        return "failed without a sentence"
    if longest := max((line for line in err.splitlines() if len(line) > LONGEST_SENTENCE), default=""):
        return f"a sentence of {len(longest)} letters: {longest[:200]}"
    if grown > MOST_BYTES:
        return f"took {grown / 1e6:.0f} MB"
    return f"took {seconds:.0f} s" if seconds > SLOW else ""


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(f.relative_to(folder)): (f.stat().st_size, f.stat().st_mtime_ns) for f in files}


def _misplaced(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]], damaged: Path) -> str:
    """Files that a command had no business to write, change or leave."""
    for name in sorted(before.keys() | after.keys()):
        if name.rpartition("/")[2].startswith(".") and name not in before:
            return f"left {name}"
        may = name.startswith(("out/", "kept/"))
        if before.get(name) != after.get(name) and not may:
            return f"changed {name}" + (" itself" if name == str(damaged) else "")
    return ""


def _numbers(path: Path) -> list[Any]:
    """All of a rig's cameras in numbers."""
    from quadrig.io.rig_file.rig_mcap import read_rig

    rig = read_rig(path)
    return [(c.name, c.intrinsics.parameters.tolist(), c.rig_from_camera.matrix().tolist()) for c in rig.cameras] + [
        np.nan_to_num(rig.covariance).tolist()
    ]


def _reset_peak() -> int:
    """Forget the peak of this process's memory; its size now (bytes)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return _peak()
    return _peak()


def _peak() -> int:
    found = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) * 1024 if found else 0


# The process that attacks.


class Attacked:
    """The process that is attacked; started again when it died or hangs."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="quadrig-fuzz-"))
        self._start()

    def _start(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        self._answers, theirs = os.pipe()
        words = [sys.executable, __file__, "--serve", str(self.folder), str(theirs)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=[theirs], cwd=self.folder)
        os.close(theirs)
        self._left = b""
        if self._answer() != "ready":
            raise SystemExit("the whole inputs cannot be made")

    def run(self, case: str) -> dict[str, Any]:
        """The answer to a case; the process is started again where there is none."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{case}\n".encode())
        self._process.stdin.flush()
        answer = self._answer()
        if isinstance(answer, dict):
            return answer
        said = (self.folder / "stderr").read_text("utf-8", "replace") if (self.folder / "stderr").exists() else ""
        self.close()
        wrong = f"hangs: no answer in {HANGS} s" if answer == "late" else f"died ({self._process.returncode})"
        kept = tempfile.mkdtemp(prefix="quadrig-fuzz-dead-")
        shutil.copytree(self.folder / "work", kept, dirs_exist_ok=True)
        self._start()
        return {"command": "?", "file": kept, "code": None, "wrong": wrong, "said": said[-3000:]}

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        os.close(self._answers)

    def _answer(self) -> Any:
        until = time.monotonic() + HANGS
        while b"\n" not in self._left:
            if not select.select([self._answers], [], [], max(0.0, until - time.monotonic()))[0]:
                return "late"
            part = os.read(self._answers, 1 << 16)
            if not part:
                return "dead"
            self._left += part
        line, _, self._left = self._left.partition(b"\n")
        return json.loads(line)


def kept_cases() -> list[str]:
    """Cases that once found something."""
    lines = CASES.read_text().splitlines() if CASES.exists() else []
    return [line.partition("#")[0].strip() for line in lines if line.partition("#")[0].strip()]


def _keep(case: str, answer: dict[str, Any]) -> None:
    folder = FINDINGS / re.sub(r"\W", "-", case)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    file = Path(answer["file"])
    if file.is_dir():
        shutil.move(file, folder / "files")
    elif file.exists():
        shutil.copy(file, folder)
    what = "\n".join([case, f"rig {answer['command']}", answer["wrong"], "", answer["said"]])
    (folder / "what.txt").write_text(what, encoding="utf-8")


def main() -> None:
    """Attack for so many minutes, and exit with 1 where something was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--reader", action="append", choices=READERS, help="these alone; repeatable")
    parser.add_argument("--case", action="append", help="READER:NUMBER, this alone; repeatable")
    parser.add_argument("--first", type=int, help="number to begin with; else any")
    parser.add_argument("--serve", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    given.first = SystemRandom().randrange(10**9) if given.first is None else given.first
    if given.serve:
        serve(Path(given.serve[0]), int(given.serve[1]))
        return
    sys.exit(_fuzz(given))


def _cases(given: argparse.Namespace) -> Iterator[str]:
    if given.case:
        yield from given.case
        return
    readers = given.reader or list(READERS)
    yield from (case for case in kept_cases() if case.rpartition(":")[0] in readers)
    until, number = time.monotonic() + 60 * given.minutes, given.first
    while time.monotonic() < until:
        yield f"{readers[number % len(readers)]}:{number}"
        number += 1


def _fuzz(given: argparse.Namespace) -> int:
    attacked, began = Attacked(), time.monotonic()
    ran: Counter[str] = Counter()
    ends: Counter[str] = Counter()
    found: dict[str, list[str]] = {}
    try:
        for case in _cases(given):
            answer = attacked.run(case)
            ran[case.rpartition(":")[0]] += 1
            ends[str(answer["code"])] += 1
            if given.case:
                print(f"rig {answer['command']}\n{answer['said'].strip()}")
            if answer["wrong"]:
                _keep(case, answer)
                found.setdefault(answer["wrong"][:80], []).append(case)
                print(f"{case}: rig {answer['command']}: {answer['wrong']}", flush=True)
    except KeyboardInterrupt:
        print("stopped")
    finally:
        attacked.close()
        shutil.rmtree(attacked.folder, ignore_errors=True)
    print(f"{(time.monotonic() - began) / 60:.1f} minutes, {ran.total()} cases from number {given.first}")
    print("by reader: " + ", ".join(f"{name} {count}" for name, count in ran.items()))
    print("exit codes: " + ", ".join(f"{code}: {count}" for code, count in sorted(ends.items())))
    print(f"findings: {sum(map(len, found.values()))} of {len(found)} kinds")
    return 1 if found else 0


if __name__ == "__main__":
    main()

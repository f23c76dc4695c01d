"""Fuzz the readers of files.

Every input is read, or refused by a BarnError of one line, within 2 s and 1 GB. The line
has neither addresses nor names of Python's classes.

    python qa/fuzz/fuzz.py --reader rows --inputs 100000 --seconds 600

Inputs are mutations of real files and of the corpus (qa/fuzz/corpus/READER). Input
number N of a seed is always the same, so that processes with other seeds share the
work. Inputs run in a child process. Findings go to --out; with any the exit code is 1.
`--corpus` reads the corpus first; with `--inputs 0` nothing else.
"""

import gc
import json
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from hashlib import sha256
from multiprocessing import get_context
from multiprocessing.sharedctypes import RawArray
from pathlib import Path
from typing import Any

import click
from fuzz_readers import READERS, Reader

from barn_worlds.base.errors import BarnError

CORPUS = Path(__file__).parent / "corpus"
LIMIT_S = float(
    os.environ.get("FUZZ_LIMIT_S", "2")
)  # of processor time, which a busy machine stretches
LIMIT_BYTES = 1 << 30
LONGEST_MESSAGE = 2000
# An address, or the name of a class: nothing that a user could look for.
_LEAK = re.compile(
    r"\bat 0x[0-9a-f]{4,}|<(class|function|module|built-in|bound|_io)\b"
    r"|\b[A-Z]\w+(Error|Exception|Warning)\b|NoneType|'\w+' object\b"
)
_HANGS_S = 20.0  # of processor time, after which a child is killed
# places in what a child shares: the input it is at, how many inputs were read without a
# refusal, and how much processor time they took
_NUMBER = 0
_READ = 1
_USED_NS = 2


def finding(reader: Reader, path: Path) -> tuple[str, bool]:
    """Return what is wrong with how a file is read, and whether it was read.

    The text is empty if nothing is wrong.
    """
    began = time.process_time()
    try:
        reader.read(path)
    except BarnError as error:
        text = str(error)
        read = False
    except Exception:
        return traceback.format_exc(), False
    else:
        text = ""
        read = True
    leak = _LEAK.search(text)
    if leak:
        return f"message with Python's {leak.group()!r}: {text[:300]!r}", read
    if "\n" in text or len(text) > LONGEST_MESSAGE:
        return (
            f"message of {len(text)} characters, or of several lines: {text[:300]!r}",
            read,
        )
    took_s = time.process_time() - began
    return (f"took {took_s:.1f} s" if took_s > LIMIT_S else ""), read


def prepare(reader: Reader, name: str, folder: Path) -> list[bytes]:
    """Return the contents that inputs are made from, and warm up the reader."""
    seeds = reader.seeds(folder)
    for seed in seeds:
        (folder / reader.name).write_bytes(seed)
        reader.read(
            folder / reader.name
        )  # an error ends the tool: a seed is to be good
    return seeds + [path.read_bytes() for path in corpus(name)]


def corpus(name: str) -> list[Path]:
    """Return the files that were found to be trouble once."""
    return sorted((CORPUS / name).glob("*"))


def fuzz(
    name: str, inputs: int, seconds: float, seed: int, out: Path, first: int = 0
) -> tuple[int, int, list[str]]:
    """Return how many inputs were tried and read, and the findings.

    The files of the findings go to `out`.
    """
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder:
        seeds = prepare(reader, name, Path(folder))
        shared = RawArray("q", [first, 0, 0])
        findings: list[str] = []
        longest_ns = seconds * 1e9
        target = first + inputs
        path = Path(folder) / reader.name

        def work() -> None:
            """Try inputs, from the first that no child has tried."""
            _limit_child()
            reported = set()
            while shared[_NUMBER] < target and shared[_USED_NS] < longest_ns:
                began_ns = time.process_time_ns()
                content = make_input(reader, seeds, name, seed, shared[_NUMBER])
                path.write_bytes(content)
                complaint, read = finding(reader, path)
                kind = "".join(complaint.splitlines()[-3:-1])[:200] or complaint
                if complaint and kind not in reported:
                    reported.add(kind)
                    keep(out, name, content, complaint)
                shared[_READ] += read
                shared[_NUMBER] += 1
                shared[_USED_NS] += time.process_time_ns() - began_ns

        while shared[_NUMBER] < target and shared[_USED_NS] < longest_ns:
            child = get_context("fork").Process(target=work)
            child.start()
            why = _watch(child, shared)
            if child.exitcode != 0:
                number = shared[_NUMBER]
                content = make_input(reader, seeds, name, seed, number)
                complaint = f"input {number} of seed {seed}: {why or child.exitcode}"
                findings.append(keep(out, name, content, complaint))
                shared[_NUMBER] = number + 1
        findings += [
            file.name for file in out.glob(f"{name}-*.txt") if file.name not in findings
        ]
        return shared[_NUMBER] - first, shared[_READ], findings


def make_input(
    reader: Reader, seeds: Sequence[bytes], name: str, seed: int, number: int
) -> bytes:
    """Return an input."""
    draw = random.Random(f"{name} {seed} {number}")
    return reader.mutate(draw, draw.choice(seeds), seeds)


def keep(out: Path, name: str, content: bytes, complaint: str) -> str:
    """Write an input and what is wrong, and return the name of the latter."""
    out.mkdir(parents=True, exist_ok=True)
    digest = sha256(content).hexdigest()
    stem = f"{name}-{digest[:12]}"
    (out / f"{stem}.bin").write_bytes(content)
    (out / f"{stem}.txt").write_text(complaint)
    return f"{stem}.txt"


def _watch(child: Any, shared: Any) -> str:
    """Wait for a child and return why it was killed, if it was.

    An input that takes far too long.
    """
    at = -1
    since_s = 0.0
    while child.is_alive():
        child.join(0.5)
        used_s = _processor_s(child.pid)
        if shared[_NUMBER] != at:
            at = shared[_NUMBER]
            since_s = used_s
        elif used_s - since_s > _HANGS_S:
            child.kill()
            child.join()
            return f"killed after {used_s - since_s:.0f} s"
    return ""


def _processor_s(pid: int) -> float:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
        fields = stat.rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def _limit_child() -> None:
    """Limit the memory of this process, and silence it."""
    pages = Path("/proc/self/statm").read_text().split()[0]
    used = int(pages) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.stderr = sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115
    gc.freeze()  # what the parent has loaded need not be looked through again and again


def _corpus_findings(name: str) -> Iterator[str]:
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder:
        prepare(reader, name, Path(folder))
        for path in corpus(name):
            (Path(folder) / reader.name).write_bytes(path.read_bytes())
            complaint, _ = finding(reader, Path(folder) / reader.name)
            if complaint:
                yield f"{path.name}: {complaint}"


@click.command()
@click.option(
    "--reader",
    "names",
    multiple=True,
    type=click.Choice(list(READERS)),
    help="Reader; all without one.",
)
@click.option(
    "--inputs", default=1_000_000, show_default=True, help="Most inputs of each reader."
)
@click.option(
    "--seconds", default=10.0, show_default=True, help="Processor time of each reader."
)
@click.option(
    "--seed", default=0, show_default=True, help="Inputs of another seed are others."
)
@click.option(
    "--first", default=0, show_default=True, help="Number of the first input."
)
@click.option(
    "--out",
    default="out/fuzz",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Findings.",
)
@click.option(
    "--corpus", "with_corpus", is_flag=True, help="Read the committed corpus first."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print a line of JSON for each reader."
)
def main(
    names: Sequence[str],
    inputs: int,
    seconds: float,
    seed: int,
    first: int,
    out: Path,
    with_corpus: bool,
    as_json: bool,
) -> None:
    """Fuzz readers; exit code 1 with findings."""
    failed = False
    for name in names or READERS:
        findings = list(_corpus_findings(name)) if with_corpus else []
        text = (
            f"{name}: {len(corpus(name))} files of the corpus, {len(findings)} findings\n"
            if with_corpus
            else ""
        )
        input_count = read = 0
        if inputs:
            input_count, read, fresh = fuzz(name, inputs, seconds, seed, out, first)
            text += f"{name}: {input_count} inputs, {read} read, {input_count - read} refused, {len(fresh)} findings\n"
            findings += fresh
        text += "".join(f"  {line}\n" for line in findings)
        whole = {
            "reader": name,
            "seed": seed,
            "inputs": input_count,
            "read": read,
            "findings": findings,
        }
        click.echo(json.dumps(whole) if as_json else text.rstrip())
        failed |= bool(findings)
    sys.exit(int(failed))


if __name__ == "__main__":
    main()

"""Mistakes on the command line, and names that are markup."""

import shutil
from collections.abc import Sequence

from fault_cases.campaigns import run_undisturbed
from fault_cases.direct import SHORT
from fault_cases.kit import Lab, add, case, cases_of, hold

FAMILY = "commands"
TAG = "<script>alert(1)</script>"


def _expect_refusal(lab: Lab, words: Sequence[object], mistake: str) -> str:
    refusal = lab.expect_refusal(*words)
    hold(mistake in refusal, refusal)
    hold(not lab.out.exists(), "a folder was made")
    return refusal.replace(str(lab.folder), "")[:200]


_MISTAKES = """
command | comapre a b | did you mean 'compare'
    The command is written `comapre`.
planner | run --planner dwaa --out out | did you mean 'dwa'
    The planner `dwaa`.
preset | run --planner dwa:challange --out out | challenge
    The preset `challange`.
protocol | run --protocol challange --out out | did you mean 'challenge'
    The protocol `challange`.
dataset | run --dataset barn30 --out out | did you mean 'barn300'
    The data set `barn30`.
world | run --worlds 300 --out out | 300
    World 300 of 300 numbered from 0.
worlds | run --worlds 0- --out out | 0-
    The worlds `0-`.
option | run --wrlds 0 --out out | --worlds
    The option `--wrlds`.
parameter | run --set max_sped_mps=1 --out out | max_speed_mps
    The parameter `max_sped_mps` of DWA.
value | run --set dwa.max_speed_mps=-1 --out out | max_speed_mps must be
    A speed of DWA of -1 m/s.
simulator | run --sim lidar.beam=1 --out out | lidar.beams
    The simulator parameter `lidar.beam`.
ros | run --mode ros --ros patience.comand_s=1 --out out | patience.command_s
    The parameter `patience.comand_s` of mode ros.
seed | run --seed -1 --out out | --seed
    A seed of -1.
folder | report no/such | no/such
    A report of a folder that is not there.
"""
for _name, _done, _words, _mistake in cases_of(_MISTAKES):
    add(
        FAMILY,
        f"typo-{_name}",
        _done,
        "Refused in one line that names the mistake and what is near or allowed.",
        _expect_refusal,
        _words.split(),
        _mistake,
    )


@case(FAMILY)
def markup_as_names(lab: Lab) -> str:
    """Folders of results are called `<script>alert(1)</script>` and `"><img src=x>`,
    and so is the page's title.

    Report and leaderboard show them as text: neither page has such an element.
    """
    names = (TAG.replace("/", "_"), '"><img src=x>')
    for name in names:
        shutil.copytree(run_undisturbed(), lab.folder / name)
    return _show_folders(lab, *names)


def _show_folders(lab: Lab, *folders: object) -> str:
    options = ["--out", "report.html", "--no-assets", "--set"]
    lab.barn("report", *folders, *options, f"title={TAG}")
    lab.barn("leaderboard", *folders, "--out", "board.html", "--out", "board.md")
    for page in ("report.html", "board.html"):
        text = (lab.folder / page).read_text()
        is_text = "<script>alert" not in text and "<img src=x" not in text
        hold(is_text, f"{page} has an element")
        hold("&lt;" in text, f"{page} does not show the names")
    return "both pages show names as text"


@case(FAMILY)
def markup_as_the_planners_name(lab: Lab) -> str:
    """A planner of a command is called `<script>alert(1)</script>` in a campaign file.

    Refused in one line that names it.
    """
    text = f'schema_version: 1\nout: out\nmode: ros\nplanners: [{{name: "{TAG}", command: "true"}}]\n'
    (lab.folder / "c.yaml").write_text(text)
    return _expect_refusal(lab, ("campaign", "c.yaml"), "<script>")


@case(FAMILY)
def markup_as_the_protocols_name(lab: Lab) -> str:
    """A protocol is called `<script>alert(1)</script>`.

    It drives; report and leaderboard show its name as text.
    """
    (lab.folder / "p.yaml").write_text(SHORT.replace("short", f'"{TAG}"'))
    words = "run --planner gap --worlds 0,9 --protocol p.yaml --bags none"
    lab.barn(*words.split(), "--out", lab.out)
    return _show_folders(lab, lab.out)


@case(FAMILY)
def quotes_in_the_folders_name(lab: Lab) -> str:
    """The folder of results is called `it's "mine" & {yours}`, with a space.

    The run works, and so do check, comparison and report.
    """
    (lab.folder / "short.yaml").write_text(SHORT)
    out = 'it\'s "mine" & {yours}'
    words = "--worlds 0,9 --repetitions 1 --protocol short.yaml --bags all"
    lab.barn("campaign", "--planners", "gap", *words.split(), "--out", out)
    lab.barn("check", out)
    lab.barn("compare", out, out)
    lab.barn("report", out, "--no-assets")
    return "2 trials, checked, compared and reported"

"""`barn reproduce` from trials to page; its training needs PyTorch."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from reproduce_work import made_up, made_up_campaign
from rich.console import Console

from barn_eval.commands.main import main
from barn_eval.experiments.config import ExecutionConfig
from barn_eval.experiments.folder import opened
from barn_eval.experiments.trials import trials
from barn_eval.studies import reproduce as run
from barn_eval.studies.config import QUICK
from barn_eval.studies.learning import PAPER
from barn_eval.studies.page import page, read_results, write_results
from barn_eval.studies.remarks import remarks_on_models
from barn_eval.studies.sections import trials_section
from barn_worlds.errors import BarnError, ConfigError

for library in ("torch", "sklearn"):
    pytest.importorskip(library, reason="models are trained with PyTorch and scikit-learn")

TINY = replace(QUICK, strata=10, repetitions=2, folds=2, transfer_per_set=1, transfer_worlds=3, transfer_all=True)
CONSOLE = Console(quiet=True)
DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Folder of made-up trials in twenty worlds."""
    path = tmp_path_factory.mktemp("campaign") / "paper"
    made_up_campaign(path, "0:300:15")
    return path


@pytest.fixture(scope="module")
def no_trials():
    """Make up the trials in new worlds, too."""

    def run_campaign(campaign, _console):
        specs = list(trials(campaign.config))
        with opened(campaign.out, campaign.config, campaign.execution, specs) as folder:
            for spec in folder.remaining:
                folder.append(made_up(spec))
            return folder.complete()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "run_campaign", run_campaign)
        yield


@pytest.fixture(scope="module")
def tiny(campaign, no_trials, tmp_path_factory):
    """What ten of the twenty worlds say, and the page."""
    return reproduce(TINY, tmp_path_factory.mktemp("out"), campaign)


def reproduce(config, out, campaign=None):
    findings, origin = run.reproduce(config, out, ExecutionConfig(workers=1), CONSOLE, campaign)
    return findings, write_results(findings, origin, out)


def test_a_second_run_writes_the_same_bytes(tiny, campaign, no_trials, tmp_path):
    findings, path = tiny
    again, elsewhere = reproduce(TINY, tmp_path / "again", campaign)
    assert again == findings
    names = ["results.md", "results.json", *(f"figures/{file.name}" for file in (path.parent / "figures").iterdir())]
    assert len(names) == 5
    for name in names:
        assert (elsewhere.parent / name).read_bytes() == (path.parent / name).read_bytes()


def test_the_page_shows_ours_beside_the_published_numbers(tiny):
    findings, path = tiny
    text = path.read_text("utf-8")
    dwa = findings.trials.of("dwa").normalised_s_per_m
    assert f"| time per metre as counted [s/m] | 3.30 | {dwa.estimate:.2f} [" in text
    assert "10 of 300 worlds, one from each of as many parts" in text
    assert "| published: the paper's network | 0.10 | 0.31 | 0.42 | 0.29 | 0.60 |" in text
    assert "| published (Fig. 8, real robot) | 0.96 | 1.17 | 0.74 |" in text
    assert all((path.parent / name).is_file() for name in _figures(text))
    assert read_results(path.parent)[0] == findings and page(*read_results(path.parent)) == text
    content = json.loads(path.with_suffix(".json").read_text())
    assert len(content["trials"]["worlds"]) == 10 and len(content["transfer"]["worlds"]) == 12
    assert not {"started_at", "wall_clock"} & set(json.dumps(content).split('"'))


def test_remarks_follow_the_numbers(tiny):
    findings, _ = tiny
    first, second = findings.trials.planners
    near = replace(first, normalised_s_per_m=replace(first.normalised_s_per_m, low=3.0, high=4.0))
    far = replace(first, normalised_s_per_m=replace(first.normalised_s_per_m, low=4.0, high=5.0))

    def said(one):
        trials = replace(findings.trials, planners=(one, second))
        return "\n".join(trials_section(replace(findings, trials=trials)))

    assert "DWA: the published mean of 3.30 s/m lies within our interval" in said(near)
    assert "DWA: the published mean of 3.30 s/m lies outside our interval" in said(far)
    assert "of our" in said(replace(first, parts=replace(first.parts, penalty_s=1.0)))
    assert "DWA: 0 of" not in said(replace(first, parts=replace(first.parts, penalty_s=0.0)))


def test_no_ratio_is_made_with_a_loss_that_is_shown_as_nothing(tiny):
    findings, _ = tiny
    network = findings.learning.of(PAPER)
    twice = replace(network, training_mse=network.mse.estimate / 3.0)
    for one, says in (
        (twice, ", 3.0 times as much on others"),
        (replace(network, training_mse=1e-9), "its training. It"),
    ):
        recipes = (one, *(other for other in findings.learning.recipes if other.recipe != PAPER))
        learning = replace(findings.learning, recipes=recipes)
        said = " ".join(remarks_on_models(replace(findings, learning=learning)))
        assert says in said and said.count("times as much") == (one is twice)


def test_an_unfinished_or_foreign_campaign_is_refused(campaign, tmp_path):
    lines = (campaign / "results.jsonl").read_text().splitlines(keepends=True)
    short = tmp_path / "short"
    short.mkdir()
    (short / "run.json").write_bytes((campaign / "run.json").read_bytes())
    (short / "results.jsonl").write_text("".join(lines[:-1]))
    with pytest.raises(ConfigError, match=r"short: has 119 of 120 trials; finish the campaign first"):
        reproduce(TINY, tmp_path / "out", short)
    content = json.loads((campaign / "run.json").read_text())
    content["campaign"]["protocol"]["name"] = "challenge"
    (short / "run.json").write_text(json.dumps(content))
    with pytest.raises(ConfigError, match="holds trials of protocol 'challenge', not 'paper'"):
        reproduce(TINY, tmp_path / "out", short)
    with pytest.raises(BarnError, match=r"run\.json: No such file"):
        reproduce(TINY, tmp_path / "out", tmp_path)
    assert not (tmp_path / "out").exists()


def test_the_command_refuses_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "--quick", "--dataset", "barn301", "--out", "here"])
    assert ended.value.code == 1
    error = capsys.readouterr().err
    assert error.splitlines()[-1].startswith("error: barn301: no such file, folder or data set; did you mean 'barn300'")
    assert not (tmp_path / "here").exists()


def test_the_page_in_docs_is_what_its_numbers_give():
    if not (DOCS / "results.json").is_file():
        pytest.skip("the repository's docs are not beside this package")
    shown = (DOCS / "results.md").read_text("utf-8")
    assert page(*read_results(DOCS)) == shown, "run python -m barn_eval.studies.page docs"
    assert all((DOCS / name).is_file() for name in _figures(shown))


def _figures(text):
    found = [part.split(")")[0] for part in text.split("](")[1:]]
    assert len(found) == 3
    return found

"""Training with PyTorch and scikit-learn: repeatable, the same in numpy, and judged in worlds held out."""

from dataclasses import replace

import numpy as np
import pytest
from test_model import made_trials

from barn_metrics.model import ModelError, load_model, save_model
from barn_metrics.model.evaluation import EvaluationConfig, evaluate
from barn_metrics.model.network_training import NetworkConfig, _forward, train_networks
from barn_metrics.model.recipes import check_stored, train_trees
from barn_metrics.model.training import train
from barn_metrics.model.trials import joined
from barn_worlds.worlds.dataset import open_dataset

torch = pytest.importorskip("torch", reason="networks are trained with PyTorch")

SMALL = NetworkConfig(epochs=200, learning_rate=0.01)


@pytest.fixture(scope="module")
def worlds():
    dataset = open_dataset("barn300")
    return {index: dataset.load(index) for index in dataset.indices[::6]}


def samples(count=60):
    generator = np.random.default_rng(2)
    x = generator.standard_normal((count, 5)) * [1.0, 10.0, 0.1, 3.0, 1.0] + 4.0
    return x, (np.abs(x[:, 0] - 4.0) + 0.3 * x[:, 3])[:, None]


def test_networks_learn_what_no_line_can():
    x, y = samples()
    (network,) = train_networks(x, y, np.ones((1, len(x)), np.bool_), SMALL, [0])
    assert np.mean((network(x) - y) ** 2) < 0.02 * y.var()


def test_training_repeats_from_its_seed_and_alone_as_among_others():
    x, y = samples()
    kept = np.ones((2, len(x)), np.bool_)
    kept[1, ::3] = False
    both = train_networks(x, y, kept, SMALL, [7, 8])
    again = train_networks(x, y, kept, SMALL, [7, 8])
    alone = train_networks(x, y, kept[1:], SMALL, [8])
    other = train_networks(x, y, kept[1:], SMALL, [9])
    assert all((a(x) == b(x)).all() for a, b in zip(both, again, strict=True))
    assert both[1](x) == pytest.approx(alone[0](x), rel=1e-3)
    assert np.abs(both[1](x) - other[0](x)).max() > 1e-3


def test_a_network_sees_nothing_of_samples_that_are_left_out():
    x, y = samples()
    kept = np.ones((1, len(x)), np.bool_)
    kept[0, :10] = False
    changed_x, changed_y = x.copy(), y.copy()
    changed_x[:10] *= 100.0
    changed_y[:10] = np.nan
    first = train_networks(x, y, kept, SMALL, [1])[0]
    second = train_networks(changed_x, changed_y, kept, SMALL, [1])[0]
    assert (first(x) == second(x)).all()


def test_numpy_evaluates_a_network_as_torch_does():
    x, y = samples()
    (network,) = train_networks(x, y, np.ones((1, len(x)), np.bool_), SMALL, [0])
    layers = [(torch.tensor(weights)[None], torch.tensor(bias)[None, None]) for weights, bias in network.layers]
    theirs = _forward(torch, layers, torch.tensor((x - network.mean) / network.std)[None])[0].numpy()
    assert network(x) == pytest.approx(theirs, rel=1e-12)


def test_trees_give_the_mean_over_those_of_scikit_learn():
    ensemble = pytest.importorskip("sklearn.ensemble", reason="trees are trained with scikit-learn")
    x, y = samples(80)
    wide = np.random.default_rng(0).uniform(-10.0, 20.0, (500, 5))
    for targets in (y, np.column_stack([y, y**2])):
        theirs = ensemble.ExtraTreesRegressor(200, min_samples_leaf=2, max_features=0.7, random_state=3)
        expected = theirs.fit(x, targets if targets.shape[1] > 1 else targets[:, 0]).predict(wide)
        found = train_trees(x, targets, 3, smallest_leaf=2)(wide)
        assert found == pytest.approx(expected.reshape(found.shape), rel=1e-5)


def test_the_papers_network_overfits_as_the_papers_did_and_says_so(worlds):
    trials = made_trials(worlds, noise=1.5)
    model = train("paper", worlds, trials)
    assert [weights.shape for weights, _ in model.members[0].function.layers] == [(5, 64), (64, 64), (64, 1)]
    assert model.about["training_mse"] < 0.12 < trials.difficulty().var()
    found = evaluate(worlds, trials, ("mean", "paper", "paper_regularised"), EvaluationConfig(folds=5, repeats=1))
    paper = found.score("paper")
    assert paper.training_mse < 0.12 < paper.mse.low
    assert found.score("paper_regularised").improvement.estimate > 0.0
    assert paper.improvement is None and paper.improvement_regularised.estimate < 0.0
    # Predicting the mean is worth nothing, whatever the folds.
    assert found.score("mean").r2.estimate == pytest.approx(0.0, abs=0.15)


def test_all_inputs_explain_what_the_five_metrics_do_not_hold(worlds, tmp_path):
    pytest.importorskip("sklearn", reason="trees are trained with scikit-learn")
    trials = made_trials(worlds)
    found = evaluate(worlds, trials, ("linear", "paper_regularised", "rich"), EvaluationConfig(folds=5, repeats=1))
    rich = found.score("rich")
    assert rich.r2.estimate > found.score("linear").r2.estimate
    assert rich.improvement_regularised.low > 0.0
    assert len(rich.predictions) == len(found.world_numbers) == len(worlds)
    model = train("rich", worlds, trials)
    assert train("rich", worlds, trials).predict(worlds[6]) == model.predict(worlds[6])
    with pytest.raises(ModelError, match="a file of weights holds networks only"):
        save_model(model, tmp_path / "w.npz")
    with pytest.raises(
        ModelError, match="recipe 'rich' has trees, which a file of weights cannot hold; choose from me"
    ):
        check_stored("rich")
    assert list(tmp_path.iterdir()) == []


def test_the_shipped_recipe_is_stored_and_trained_again_alike(worlds, tmp_path):
    trials = made_trials(worlds)
    model = train("routes", worlds, trials)
    save_model(model, tmp_path / "w.npz")
    assert load_model(tmp_path / "w.npz").predict(worlds[6]) == model.predict(worlds[6])
    save_model(train("routes", worlds, trials), tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "w.npz").read_bytes()


def test_nothing_is_trained_on_the_worlds_held_out_by_whatever_name(worlds):
    held_out = open_dataset("barn_test")
    renamed = {number: replace(held_out.load(number), name=f"mine_{number}") for number in held_out.indices[:20]}
    with pytest.raises(ModelError, match="mine_0 is a world of barn_test, which judges models and is never trained on"):
        train("linear", renamed, made_trials(renamed))
    mixed = worlds | {1000: held_out.load(7)}
    with pytest.raises(ModelError, match="is a world of barn_test"):
        train("linear", mixed, made_trials(mixed))
    config = EvaluationConfig(folds=2, repeats=1)
    judged = evaluate(renamed, made_trials(renamed), ["linear"], config, further=(worlds, made_trials(worlds)))
    assert judged.further_worlds == len(worlds)
    with pytest.raises(ModelError, match="is a world of barn_test"):
        evaluate(worlds, made_trials(worlds), ["linear"], config, further=(renamed, made_trials(renamed)))


def split(worlds, trials):
    """Return two samples: every other world, and the trials there."""
    halves = []
    for first in (0, 1):
        chosen = {index: worlds[index] for index in list(worlds)[first::2]}
        halves.append((chosen, trials.only(chosen)))
    return halves


def test_campaigns_are_joined_by_world_whatever_their_numbers(worlds):
    trials = made_trials(worlds, repetitions=1)
    (one, some), (other, rest) = split(worlds, trials)
    renumbered = dict(enumerate(other.values()))
    numbers = dict(zip(other, renumbered, strict=True))
    moved = replace(rest, worlds=np.array([numbers[int(index)] for index in rest.worlds]))
    found_worlds, found = joined([(one, some), (renumbered, moved), (one, some)])
    assert len(found_worlds) == len(worlds) and len(found) == len(trials) + len(some)
    expected = {
        worlds[index].checksum: value for index, value in zip(trials.world_numbers, trials.difficulty(), strict=True)
    }
    assert [expected[found_worlds[number].checksum] for number in found.world_numbers] == pytest.approx(
        found.difficulty()
    )
    with pytest.raises(ModelError, match="there are trials of world 1, but not the world itself"):
        joined([({0: renumbered[0]}, moved)])
    with pytest.raises(ModelError, match="there are trials of world 9999, but not the world itself"):
        joined([(renumbered, replace(moved, worlds=np.where(np.arange(len(moved)) == 0, 9_999, moved.worlds)))])


def test_models_trained_in_other_worlds_have_seen_none_that_they_are_judged_on(worlds):
    trials = made_trials(worlds)
    (one, some), (other, rest) = split(worlds, trials)
    config = EvaluationConfig(folds=5, repeats=2)
    found = evaluate(one, some, ("mean", "linear"), config, further=(other, rest))
    assert (found.worlds, found.further_worlds, found.further_trials) == (len(one), len(other), len(rest))
    mean = rest.difficulty().mean()
    assert found.score("mean").predictions == pytest.approx([mean] * len(one))
    assert found.score("mean").training_mse == pytest.approx(rest.difficulty().var())
    linear = train("linear", other, rest)
    expected = [linear.predict(world).difficulty_s_per_m for world in one.values()]
    assert found.score("linear").predictions == pytest.approx(expected)
    with pytest.raises(ModelError, match=r"world \d+ is judged and among the further trials"):
        evaluate(one, some, ("mean",), config, further=(worlds, trials))
    with pytest.raises(ModelError, match="further trials must be of the same planners, quick, slow, got quick"):
        evaluate(one, some, ("mean",), config, further=(other, rest.of("quick")))

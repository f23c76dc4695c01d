"""Worlds from easy to difficult."""

import pytest

gymnasium = pytest.importorskip("gymnasium")

from policy_training.curriculum import Curriculum, CurriculumConfig  # noqa: E402

import barn_eval.gym  # noqa: E402


@pytest.fixture
def make():
    environments = []

    def build(worlds="0-10", **config):
        env = gymnasium.make(
            barn_eval.gym.ENVIRONMENT_ID, worlds=worlds, **{"observation.beams": 12}
        )
        environments.append(Curriculum(env, CurriculumConfig(**config)))
        return environments[-1]

    yield build
    for env in environments:
        env.close()


def draw_worlds(env, seeds=range(40)):
    return {env.reset(seed=seed)[1]["world"] for seed in seeds}


def test_worlds_come_up_to_the_level_and_repeat_from_the_seed(make):
    env = make(first_level=0.3)
    assert draw_worlds(env) == {0, 1, 2, 3}
    env.reset(seed=9)
    worlds = [env.reset()[1]["world"] for _ in range(20)]
    env.reset(seed=9)
    assert worlds == [env.reset()[1]["world"] for _ in range(20)]
    assert draw_worlds(make("7", first_level=0.0)) == {7}


def test_the_level_rises_with_success_only(make):
    env = make(first_level=0.2, step=0.5, promotion_rate=0.75, window=4)
    assert [env.record(success) for success in (True, False, True)] == [False] * 3
    assert not env.record(False) and env.level == 0.2
    assert not env.record(True)  # of the last four, two
    assert env.record(True) and env.level == 0.7
    assert draw_worlds(env) == set(range(8))
    assert not any(env.record(True) for _ in range(3))  # counted anew
    assert env.record(True) and env.level == 1.0
    assert not any(env.record(True) for _ in range(8)) and env.level == 1.0


def test_the_end_of_an_episode_counts(make):
    env = make(first_level=0.1, window=1, promotion_rate=0.0)
    env.reset(seed=0, options={"world": 0})
    ended = False
    while not ended:
        *_, terminated, truncated, info = env.step([1.0, 0.0])
        ended = terminated or truncated
    assert info["outcome"] and env.level == pytest.approx(0.15)

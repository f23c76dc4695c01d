"""Physics clients that robots take turns with."""

from contextlib import closing
from dataclasses import replace

from barn_sim.body.model import model_of
from barn_sim.config import SimulatorConfig
from barn_sim.contact.scene import ScenePool


def test_robots_of_many_kinds_do_not_pile_up_clients():
    config = SimulatorConfig()
    model = model_of(config.chassis)
    scenes = []
    with closing(ScenePool()) as pool:
        for friction in (0.3, 0.4, 0.5, 0.5):
            physics = replace(config.physics, chassis_friction=friction)
            scenes.append(pool.acquire(model, physics))
            pool.release(scenes[-1])
        assert scenes[2] is scenes[3]
        assert len({scene.client for scene in scenes}) == 1

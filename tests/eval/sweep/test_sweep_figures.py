import numpy as np
import pytest

from fuzzyarm.eval.sweep.config import Axis, SweepConfig
from fuzzyarm.eval.sweep.distributions import columns_of, plant_record
from fuzzyarm.eval.sweep.episodes import SweepResults
from fuzzyarm.eval.sweep.figures import Cells, draw_sweep, write_sweep_figures
from fuzzyarm.eval.sweep.summary import summarise

GRID = SweepConfig(
    policies=("fuzzy-4", "a"), cases=("nominal", "payload"), distribution="plants", plants=3,
    grid=(Axis("stiffness", 0.5, 1.5, 5), Axis("delay", 0, 3, 4)),
)  # fmt: skip
DRAWN = SweepConfig(policies=("fuzzy-4",), cases=("nominal",), plants=500, distribution="all")


def made(config, ended=True):
    generator = np.random.default_rng(0)
    plants = np.empty(config.total, dtype=plant_record(2))
    for name in columns_of(2):
        plants[name] = generator.uniform(size=config.total)
    plants["delay"] = generator.integers(0, 3, config.total)
    if config.grid:
        cell = np.arange(config.total) // config.plants
        first, second = config.grid
        plants["stiffness_1"] = first.values[cell // second.number]
        plants["delay"] = second.values[cell % second.number]
    shape = len(config.policies), len(config.cases), config.total
    completed = np.ones(shape, dtype=bool)
    if ended:
        completed[..., :3] = False
    largest = generator.lognormal(2.5, 1.0, shape)
    return SweepResults(plants, {"max_mm": largest, "rms_mm": largest / 3}, seconds=largest, completed=completed)


def test_the_cells_of_a_grid_hold_the_medians_of_their_plants():
    results = made(GRID)
    cells = Cells.of(GRID, results.plants)
    errors = results.metrics["max_mm"][0, 0]
    expected = np.median(errors.reshape(5, 4, 3), axis=-1).T
    assert np.array_equal(cells.medians(errors), expected)
    assert np.allclose(cells.edges[0], [0.375, 0.625, 0.875, 1.125, 1.375, 1.625])
    assert np.allclose(cells.edges[1], [-0.5, 0.5, 1.5, 2.5, 3.5])


@pytest.mark.parametrize("config", [GRID, DRAWN])
def test_every_axis_has_its_unit(config):
    results = made(config)
    rows = summarise(config, results)["rows"]
    figures = draw_sweep(config, results, rows)
    assert set(figures) == {"spread", *(f"map-{name}" for name in config.policies)}
    for figure in figures.values():
        panels = [axes for axes in figure.axes if axes.get_title(loc="left") or axes.get_title()]
        labels = [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()]
        labels += [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
        assert len(panels) == len(config.cases) and len(labels) >= 2
        assert all("[" in label and "]" in label for label in labels)


def test_the_label_of_code_makes_a_file_name_for_every_system(tmp_path):
    config = SweepConfig(policies=("lab.mine:make",), cases=("nominal",), plants=30)
    results = made(config)
    paths = write_sweep_figures(config, results, summarise(config, results)["rows"], tmp_path)
    assert {path.name for path in paths} >= {"map-lab.mine-make.png", "map-lab.mine-make.svg"}

"""What is made for the equations of the two-joint arm, under the names that its tests use."""

from fuzzyarm.envs.batch.kernels import kernels_of
from fuzzyarm.envs.batch.layout import layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.batch.workers import Workers
from fuzzyarm.envs.physics.hold import hold_of
from fuzzyarm.envs.physics.records import State, in_list, reader
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.task import assess_of, finite_of, target_record

PHYSICS = two_joints()
KERNELS, LAYOUT = kernels_of(PHYSICS), layout_of(PHYSICS)
Draw, Row, Target = draw_record(2), row_record(2, 2), target_record(2)
hold, assess, finite = hold_of(PHYSICS), assess_of(PHYSICS), finite_of(PHYSICS)
split, WIDTH = LAYOUT.split, LAYOUT.width
_read_state = reader(State, in_list)


def advance(values, clock, table, period, substeps, action, out):
    """One control step of all lanes, in one thread."""
    assert Workers(len(action), 1).step(KERNELS.advance, (values, clock, table, period, substeps), action, out) == -1


def state_of(numbers):
    """The state from its eight numbers or rows."""
    return _read_state(numbers, 0)

"""What is made for the equations of the two-joint arm, under the names that its tests use."""

from fuzzyarm.envs.batch.layout import VECTORS, layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.records import State, filled
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.task import assess_of, target_record

PHYSICS = two_joints()
LAYOUT = layout_of(PHYSICS)
Draw, Row, Target = draw_record(2), row_record(2, 2), target_record(2)
hold, assess = hold_of(PHYSICS), assess_of(PHYSICS)


def named(vectors):
    """The vectors by name, from the rows that a `Layout` gives."""
    return dict(zip(VECTORS, LAYOUT.each(vectors), strict=True))


def state_of(numbers):
    """The state from its eight numbers or rows."""
    return filled(State, numbers)

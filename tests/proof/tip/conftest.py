import numpy as np
import pytest
from flint import ctx

from fuzzyarm.proof.tip.enclosures import BITS


@pytest.fixture
def precision():
    """Compute as a tube is proven: balls of its precision, floats without warnings."""
    with ctx.workprec(BITS), np.errstate(all="ignore"):
        yield

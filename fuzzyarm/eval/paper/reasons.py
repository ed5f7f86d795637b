"""Reasons why our numbers differ from the paper's, and other remarks; the numbers in these texts are measured."""

__all__ = [
    "CIRCLE", "CIRCLE_FORCE", "FEASIBILITY", "FORCE_PROFILE", "FREE_L", "GAINS", "INTEGRAL_GAIN", "NO_NUMBER", "PEAKS",
    "SIMILAR", "TRUE_SIZE", "UNBOUNDED", "WORST",
]  # fmt: skip

FORCE_PROFILE = (
    "The paper prints the range, not the course over time. Ours is our choice: half a sine over the movement, faded "
    "below 0.01 m/s."
)
FEASIBILITY = (
    "Ours are proofs, not solver results: files with strictly feasible points of Theorem 2 for 4, 2 and 1 rules, with "
    "and without integral, with one multiplier as printed and with several, at the paper's alpha and Q and within "
    "(24); gamma is 1000, the paper prints none. They are easily missed: without scaling, the solver ends in "
    "numerical errors. We do not know why the authors found none."
)
UNBOUNDED = (
    "Nothing in the inequalities limits the gains: from a solution with z1 kept, gains of any size follow in closed "
    "form. Ours is one such file, proven, and its size is our choice. The paper's value is probably where its solver "
    "stopped."
)
GAINS = (
    "The inequalities and (24) leave a set of gains; the paper says neither which objective chose its own nor gamma. "
    "Ours has the smallest bound on gains scaled to the arm's units. It is compared with the largest of the entries "
    "that the paper prints, those with i = 1."
)
INTEGRAL_GAIN = (
    f"{GAINS} Its K and H have opposite signs, ours, with x_I the integral of C_p e, the same sign, which the loop "
    "needs to be stable."
)
FREE_L = (
    "Theorems 1 and 2 treat r and x_r as independent signals, so nothing makes their L follow the movement. Left to "
    "the solver it asks for thousands of N m of an arm at rest, where gravity needs 79, and throws the arm "
    "centimetres off the circle. But at the same alpha and gamma every share from 0 to 1 of the consistent form's L "
    "is proven too, with a bound on the gains that differs by less than 0.3 %, and so is the L that the paper prints "
    "(gamma-of-L), which is next to nothing: its rows go as 3844 : 124 : 1, 0.0038 times those of B_r. The printed "
    "form here has the smallest, L = 0: the feedback alone holds the arm, gravity included."
)
CIRCLE = (
    "The paper does not say on which side of the joints. At the motors the printed form errs by 0.8 mm with 32 rules "
    "and 2.1 mm with 4, so 1.3 mm lies between them; with the consistent form's L it is 0.4 mm. At the tip the "
    "joints' bending, which a law on motor angles cannot measure, makes all of them 2.5 to 3 mm. The paper's own "
    "gains give neither here, but only those with i = 1 are printed, and are used for i = 2 as well."
)
CIRCLE_FORCE = (
    "The side is not stated, and the force's course over time is our choice. The motors stay within 3.1 mm of the "
    "circle in either form; the tip goes about as far inwards as the paper's radius and one to two and a half "
    "millimetres farther outwards."
)
NO_NUMBER = "The paper gives a figure and no number."
WORST = (
    "In the printed form Case 2 is the worst on both sides, as in the paper, in the consistent form only at the "
    "motors: at the tip its Cases 2 and 3 are alike. The payload is read as a point mass at the tip, the harder "
    "reading, and acts from t = 0."
)
SIMILAR = (
    "In the consistent form 32 and 4 rules are within half a millimetre of each other in every case, in the printed "
    "form, whose feedback alone carries the arm, within two and a half."
)
PEAKS = (
    "The consistent form needs what the movement needs, see rigid-torque. The printed form needs up to 1.5 % more, "
    "and with 4 rules 10 % more of joint 2."
)
TRUE_SIZE = (
    "The paper's formula is reproduced exactly, but it does not count the variables and rows of its theorem. This "
    "does, for Theorem 2 (32 rules: Theorem 1) without integral, one multiplier for all dropped premises of A, gamma "
    "free."
)

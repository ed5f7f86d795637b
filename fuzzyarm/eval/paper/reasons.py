"""Reasons why our numbers differ from the paper's, and other remarks; the numbers in these texts are measured."""

__all__ = [
    "CIRCLE",
    "CIRCLE_FORCE",
    "FEASIBILITY",
    "FORCE_PROFILE",
    "FREE_L",
    "GAINS",
    "INTEGRAL_GAIN",
    "LEFT_BOX",
    "NO_NUMBER",
    "SATURATED",
    "SIMILAR",
    "TRUE_SIZE",
    "UNBOUNDED",
    "WORST",
]

__all__ = [
    "CIRCLE",
    "CIRCLE_FORCE",
    "FEASIBILITY",
    "FORCE_PROFILE",
    "FREE_L",
    "GAINS",
    "INTEGRAL_GAIN",
    "LEFT_BOX",
    "NO_NUMBER",
    "SATURATED",
    "SIMILAR",
    "TRUE_SIZE",
    "UNBOUNDED",
    "WORST",
]

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
    "Theorems 1 and 2 treat r and x_r as independent signals, so nothing makes their L follow the movement, and gamma "
    "decides how large it is. At our gamma of 1000, L commands thousands of N m for an arm at rest, where gravity "
    "needs 79; the motors saturate and throw the arm centimetres off the circle. K and H are not the cause: with the "
    "consistent form's L they do as well as the consistent form in Case 1, and Theorem 2 proves that law too, at a "
    "larger gamma (gamma-of-L), as it does with the paper's L, hundreds of times smaller than ours. The paper prints "
    "no gamma."
)
CIRCLE = (
    "The paper does not say on which side of the joints. In the consistent form the motors stay within half a "
    "millimetre of the circle, and the joints' bending, which a law on motor angles cannot measure, makes it 2.5 mm "
    "at the tip; 1.3 mm lies between the two. The printed form is thrown off by its L, see feedforward-at-rest. The "
    "paper's own gains give neither here, but only those with i = 1 are printed, and are used for i = 2 as well."
)
CIRCLE_FORCE = (
    "The side is not stated, and the force's course over time is our choice. In the consistent form the motors stay "
    "within 1.5 mm of the circle; the tip goes as far inwards as the paper's radius and a millimetre or two farther "
    "outwards. The printed form is thrown off by its L, see feedforward-at-rest; with 32 rules it leaves the box "
    "(25), where its proof ends; the number covers the motion until then."
)
NO_NUMBER = "The paper gives a figure and no number."
WORST = (
    "In the consistent form Case 2 is the worst of the motors, as in the paper, while at the tip Cases 2 and 3 are "
    "alike: the payload is read as a point mass at the tip, the harder reading, and acts from t = 0. In both cases "
    "the printed form is thrown off by its L."
)
SIMILAR = (
    "In the consistent form 32 and 4 rules are within half a millimetre of each other in every case. In the printed "
    "form each is thrown off by its own L, see feedforward-at-rest, in Case 2 with 32 rules out of the box (25)."
)
SATURATED = (
    "The printed form's L drives the motors to their limits, 500 and 250 N m here; the paper prints none. The "
    "consistent form needs what the movement needs, see rigid-torque. The two laws in the last columns come within "
    "1.5 % of it."
)
LEFT_BOX = (
    "In Case 2 the printed form with 32 rules leaves the joint velocities of (25) before the end, after its L has "
    "thrown it off; the episode ends there, as does the proof."
)
TRUE_SIZE = (
    "The paper's formula is reproduced exactly, but it does not count the variables and rows of its theorem. This "
    "does, for Theorem 2 (32 rules: Theorem 1) without integral, one multiplier for all dropped premises of A, gamma "
    "free."
)

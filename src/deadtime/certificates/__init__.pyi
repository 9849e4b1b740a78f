from .certificate import Certificate as Certificate
from .certify import certify as certify
from .theorem.backstepping import (
    Backstepping as Backstepping,
    lyapunov_derivative as lyapunov_derivative,
    lyapunov_functional as lyapunov_functional,
    mismatch_at as mismatch_at,
    target_rate as target_rate,
)
from .theorem.bound import TheoremBound as TheoremBound, theorem_bound as theorem_bound
from .verification import Verification as Verification, verify as verify
from .worst_case import GrowthProof as GrowthProof
from .worst_case.falsify import falsify as falsify
from .worst_case.witness import WorstCase as WorstCase

from .lyapunov import (
    CommonLyapunov as CommonLyapunov,
    common_lyapunov as common_lyapunov,
    stabilize as stabilize,
)
from .state_feedback import check_gains as check_gains, lqr as lqr, place as place

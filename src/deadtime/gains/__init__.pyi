from .checked_gains import check_gains as check_gains
from .lyapunov import CommonLyapunov as CommonLyapunov, common_lyapunov as common_lyapunov
from .stabilization import stabilize as stabilize
from .state_feedback import lqr as lqr, place as place

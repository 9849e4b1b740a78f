from .delay import DelayMargin as DelayMargin, delay_margin as delay_margin
from .drawn_plants import DrawnStability as DrawnStability, drawn_stability as drawn_stability
from .dwell_time import LeastDwellTime as LeastDwellTime, least_dwell_time as least_dwell_time
from .gain import GainMargin as GainMargin, gain_margin as gain_margin
from .loop_view import (
    LoopView as LoopView,
    ModeView as ModeView,
    loop_transfer as loop_transfer,
    loop_view as loop_view,
)
from .mode_lag import LongestModeLag as LongestModeLag, longest_mode_lag as longest_mode_lag
from .robustness import Robustness as Robustness, robustness as robustness
from .stability import (
    StabilityChart as StabilityChart,
    StabilityMargin as StabilityMargin,
    stability_chart as stability_chart,
    stability_margin as stability_margin,
)
from .step_response import StepResponse as StepResponse, step_response as step_response
from .tolerance import NoisePrice as NoisePrice, Tolerance as Tolerance

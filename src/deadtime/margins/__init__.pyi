from .chart import StabilityChart as StabilityChart, stability_chart as stability_chart
from .constant_modes import DelayMargin as DelayMargin
from .delay import delay_margin as delay_margin
from .drawn_plants import (
    DrawnStability as DrawnStability,
    drawn_stability as drawn_stability,
)
from .dwell_time import LeastDwellTime as LeastDwellTime, least_dwell_time as least_dwell_time
from .gain import GainMargin as GainMargin, gain_margin as gain_margin
from .loop_transfer import loop_transfer as loop_transfer
from .loop_view import LoopView as LoopView, ModeView as ModeView, loop_view as loop_view
from .mode_lag import LongestModeLag as LongestModeLag, longest_mode_lag as longest_mode_lag
from .robustness.assess import Robustness as Robustness, robustness as robustness
from .robustness.tolerance import NoisePrice as NoisePrice, Tolerance as Tolerance
from .stability import StabilityMargin as StabilityMargin, stability_margin as stability_margin
from .step_response import StepResponse as StepResponse, step_response as step_response

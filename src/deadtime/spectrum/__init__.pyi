from .characteristic import (
    CharacteristicRoots as CharacteristicRoots,
    characteristic_roots as characteristic_roots,
)
from .growth import (
    constant_growth as constant_growth,
    growth_bounds as growth_bounds,
    growth_rate as growth_rate,
    least_growth as least_growth,
)
from .lifted import (
    DENSE as DENSE,
    LiftedLoop as LiftedLoop,
    aged_row as aged_row,
    lifted_loop as lifted_loop,
    with_memory as with_memory,
)

from .controller import Controller as Controller
from .controller_arguments import Status as Status
from .export import (
    Exported as Exported,
    ExportedFmu as ExportedFmu,
    Names as Names,
    export_c as export_c,
    export_fmu as export_fmu,
    export_plant_fmu as export_plant_fmu,
)
from .interop import (
    law_to_control as law_to_control,
    loop_to_control as loop_to_control,
    plant_to_control as plant_to_control,
)
from .prediction import Prediction as Prediction

from .api import UPRIGHT as UPRIGHT
from .api import Identified as Identified
from .api import Pendubot as Pendubot
from .api import accelerations as accelerations
from .api import check as check
from .api import compare as compare
from .api import describe as describe
from .api import identify as identify
from .api import read as read
from .api import simulate as simulate
from .errors import PendubotError as PendubotError
from .level import Level as Level
from .model.parameters import Parameters as Parameters
from .model.simulation import HANGING as HANGING
from .trajectories.trajectory import Trajectory as Trajectory

__version__: str

from .api import HANGING as HANGING
from .api import UPRIGHT as UPRIGHT
from .api import Identified as Identified
from .api import Level as Level
from .api import Parameters as Parameters
from .api import Pendubot as Pendubot
from .api import PendubotError as PendubotError
from .api import Trajectory as Trajectory
from .api import accelerations as accelerations
from .api import identify as identify
from .api import read as read
from .api import simulate as simulate

__version__: str

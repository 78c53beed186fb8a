"""Training of the speech encoder and of both stages: ``run(kind, config, overrides, data, out)``."""

from freetalk.train.config import KINDS, TrainingConfig, load_config
from freetalk.train.losses import motion_loss
from freetalk.train.run import run
from freetalk.train.task import TrainingResult

__all__ = ["KINDS", "TrainingConfig", "TrainingResult", "load_config", "motion_loss", "run"]

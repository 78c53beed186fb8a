"""Folders of weights on the Hugging Face hub: ``download``, ``push`` and the ``model_card`` that goes with them."""

from freetalk._hub import FILES, download, model_card, push

__all__ = ["FILES", "download", "model_card", "push"]

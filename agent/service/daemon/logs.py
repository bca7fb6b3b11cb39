"""Logging on stdout for the system journal. Each record is a JSON object on one line; it names the run and the step if
they are known."""

from __future__ import annotations

import logging
import sys

import structlog
from structlog.typing import Processor

from agent.lasting_output import lasting

_SHARED: tuple[Processor, ...] = (
    structlog.contextvars.merge_contextvars,
    structlog.processors.add_log_level,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
)


def log_as_json(level: int) -> None:
    """Set up logging in one JSON format for this program and for the libraries that it uses."""
    as_line = structlog.processors.JSONRenderer(ensure_ascii=False, default=str)
    rendered: tuple[Processor, ...] = (structlog.processors.format_exc_info, as_line)
    structlog.configure(
        processors=[*_SHARED, *rendered],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(lasting(sys.stdout)),
    )
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[*_SHARED, structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *rendered],
        )
    )
    logging.basicConfig(level=max(level, logging.WARNING), handlers=[handler], force=True)

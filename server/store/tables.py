"""The service's own tables, beside those of the job engine."""

from __future__ import annotations

from sqlalchemy import JSON, BigInteger, Column, Float, Index, Integer, MetaData, String, Table, Text, UniqueConstraint

metadata = MetaData()

# Captures and jobs: what was asked, how far it is, and the last status that was announced.
entries = Table(
    "entries",
    metadata,
    Column("id", String(32), primary_key=True),  # sorts by time
    Column("kind", String(8), nullable=False),
    Column("type", String(32), nullable=False),
    Column("created", String(40), nullable=False),
    Column("rig", String(64)),
    Column("capture", String(32)),
    Column("name", String(80)),
    Column("queue", String(80)),  # None: nothing is to be done, or it was done when the entry was made
    Column("priority", Integer, nullable=False),
    Column("request", JSON, nullable=False),
    Column("progress", JSON, nullable=False),
    Column("restart", JSON),  # {"stage", "attempt"}: from which stage a job was told to begin again
    Column("told", String(12), nullable=False),
    Index("entries_by_kind", "kind", "id"),
    Index("entries_by_told", "told"),
)

# What happened to an entry, numbered in the order in which it became visible.
events = Table(
    "events",
    metadata,
    Column("seq", Integer, primary_key=True, autoincrement=True),
    Column("entry", String(32), nullable=False, index=True),
    Column("at", Float, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("data", JSON, nullable=False),
    sqlite_autoincrement=True,  # a number is never given twice, so a client's last one stays meaningful
)

artefacts = Table(
    "artefacts",
    metadata,
    Column("entry", String(32), primary_key=True),
    Column("name", String(200), primary_key=True),
    Column("media_type", String(80), nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("modified_ns", String(24), nullable=False),
)

# A key that a client may send again: the entries it made, and a digest of what it asked for.
idempotency = Table(
    "idempotency",
    metadata,
    Column("key", String(200), primary_key=True),
    Column("digest", String(64), nullable=False),
    Column("entries", JSON, nullable=False),
    Column("at", Float, nullable=False),
)

workers = Table(
    "workers",
    metadata,
    Column("id", String(80), primary_key=True),
    Column("token", String(32), nullable=False),  # of the process that holds the id
    Column("host", String(80), nullable=False),
    Column("pid", Integer, nullable=False),
    Column("queues", JSON, nullable=False),
    Column("started", Float, nullable=False),
    Column("beat", Float, nullable=False),
)

calibrations = Table(
    "calibrations",
    metadata,
    Column("rig", String(64), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("created", String(40), nullable=False),
    Column("source", String(40), nullable=False),  # natural, board, pixels or uploaded
    Column("job", String(32)),
    Column("sha256", String(64), nullable=False),
    Column("document", Text, nullable=False),  # RIG.toml
    Column("report", JSON, nullable=False),
    UniqueConstraint("rig", "job"),  # a job finds one
)

current_calibrations = Table(
    "current_calibrations",
    metadata,
    Column("rig", String(64), primary_key=True),
    Column("version", Integer, nullable=False),
    Column("revision", Integer, nullable=False),  # counts every change, also back to an old version
)

uploads = Table(
    "uploads",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("created", String(40), nullable=False),
    Column("name", String(80)),
    Column("bytes", BigInteger, nullable=False),
    Column("sha256", String(64)),
    Column("state", String(12), nullable=False),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("created", String(40), nullable=False),
    Column("url", Text, nullable=False),
    Column("secret", String(80), nullable=False),
    Column("statuses", JSON, nullable=False),
)

# What is owed to a webhook, with all that is sent: the entry may be deleted before it arrives.

deliveries = Table(
    "deliveries",
    metadata,
    Column("webhook", String(32), primary_key=True),
    Column("event", Integer, primary_key=True),
    Column("body", Text, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("next", Float, nullable=False),  # when it is due or, once it is over, when it ended
    Column("status", String(12), nullable=False),  # waiting, delivered or failed
    Column("said", String(200), nullable=False),
    Index("deliveries_due", "status", "next"),
)

tokens = Table(
    "tokens",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("digest", String(64), nullable=False),
    Column("role", String(12), nullable=False),
    Column("name", String(80), nullable=False),
    Column("created", String(40), nullable=False),
    UniqueConstraint("name"),
)

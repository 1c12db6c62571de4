"""The tables. Change them together with a new file in `migrations/versions`; a test compares the two.

`number` columns count creations and are the cursor of pagination; `fingerprint` is the digest of the request that
made a resource under an `Idempotency-Key`. `events` and `journal` are append-only; `plans.operation_id` is the
operation that flew the plan, if one did. `plans.service` is the service that solves it, where there are several;
`leases` and `leased_vehicles` say which of them each operation and its vehicles belong to (`lease_book`). `slot_rates`
has what users of an operation without a fixed end got in each slot, once that is no longer in memory.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Double,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)

_Number = BigInteger().with_variant(Integer(), "sqlite")
"""SQLite gives ids by itself only to a column of type INTEGER."""

plans = Table(
    "plans",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("number", BigInteger, nullable=False, unique=True),
    Column("created_at", Double, nullable=False),
    Column("ended_at", Double),
    Column("owner", String(64), nullable=False),
    Column("fingerprint", String(64)),
    Column("status", String(16), nullable=False),
    Column("revision", Integer, nullable=False),
    Column("parent", String(64)),
    Column("cause", Text, nullable=False),
    Column("scenario", Text, nullable=False),
    Column("asked", Text),
    Column("summary", Text),
    Column("result", Text),
    Column("error", Text),
    Column("operation_id", String(64)),
    Column("service", String(64)),
    Index(None, "status"),
    Index(None, "ended_at"),
    Index(None, "parent"),
    Index(None, "operation_id"),
)

contingencies = Table(
    "contingencies",
    metadata,
    Column("plan_id", String(64), primary_key=True),
    Column("at_slot", Integer, primary_key=True),
    Column("uav_id", String(64), primary_key=True),
    Column("disruption_weight", Double, primary_key=True),
    Column("created_at", Double, nullable=False),
    Column("result", Text),
    Column("error", Text),
    ForeignKeyConstraint(["plan_id"], ["plans.id"], ondelete="CASCADE"),
)

vehicles = Table(
    "vehicles",
    metadata,
    Column("uav_id", String(64), primary_key=True),
    Column("system_id", Integer, nullable=False, unique=True),
    Column("simulated", Boolean, nullable=False),
    Column("registered_at", Double, nullable=False),
)

operations = Table(
    "operations",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("number", BigInteger, nullable=False, unique=True),
    Column("created_at", Double, nullable=False),
    Column("ended_at", Double),
    Column("fingerprint", String(64)),
    Column("plan_id", String(64), nullable=False),
    Column("policy", String(16), nullable=False),
    Column("state", String(16), nullable=False),
    Column("version", Integer, nullable=False),
    Column("document", Text, nullable=False),
    Index(None, "state"),
    Index(None, "plan_id"),
    Index(None, "ended_at"),
)

leases = Table(
    "leases",
    metadata,
    Column("operation_id", String(64), primary_key=True),
    Column("owner", String(64), nullable=False),
    Column("name", String(64), nullable=False),
    Column("token", BigInteger, nullable=False),
    Column("beat", BigInteger, nullable=False),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
)

leased_vehicles = Table(
    "leased_vehicles",
    metadata,
    Column("system_id", Integer, primary_key=True, autoincrement=False),
    Column("operation_id", String(64), nullable=False),
    ForeignKeyConstraint(["operation_id"], ["leases.operation_id"], ondelete="CASCADE"),
    Index(None, "operation_id"),
)

journal = Table(
    "journal",
    metadata,
    Column("id", _Number, primary_key=True, autoincrement=True),
    Column("operation_id", String(64), nullable=False),
    Column("incident", Integer, nullable=False),
    Column("step", String(24), nullable=False),
    Column("uav_id", String(64)),
    Column("at", Double, nullable=False),
    Column("elapsed_s", Double),
    Column("data", Text, nullable=False),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
    Index(None, "operation_id"),
)

track = Table(
    "track",
    metadata,
    Column("id", _Number, primary_key=True, autoincrement=True),
    Column("operation_id", String(64), nullable=False),
    Column("elapsed_s", Double, nullable=False),
    Column("positions", Text, nullable=False),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
    Index(None, "operation_id"),
)

measurements = Table(
    "measurements",
    metadata,
    Column("id", _Number, primary_key=True, autoincrement=True),
    Column("operation_id", String(64), nullable=False),
    Column("uav_id", String(64), nullable=False),
    Column("user_id", String(64), nullable=False),
    Column("elapsed_s", Double, nullable=False),
    Column("rate_bps", Double),
    Column("sinr_db", Double),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
    Index(None, "operation_id"),
)

slot_rates = Table(
    "slot_rates",
    metadata,
    Column("operation_id", String(64), primary_key=True),
    Column("slot", Integer, primary_key=True, autoincrement=False),
    Column("rates_bps", Text, nullable=False),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
)

assigned_missions = Table(
    "given",
    metadata,
    Column("id", _Number, primary_key=True, autoincrement=True),
    Column("operation_id", String(64), nullable=False),
    Column("uav_id", String(64), nullable=False),
    Column("document", Text, nullable=False),
    ForeignKeyConstraint(["operation_id"], ["operations.id"], ondelete="CASCADE"),
    Index(None, "operation_id"),
)

drills = Table(
    "drills",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("number", BigInteger, nullable=False, unique=True),
    Column("created_at", Double, nullable=False),
    Column("fingerprint", String(64)),
    Column("operation_id", String(64)),
    Column("state", String(16), nullable=False),
    Column("document", Text, nullable=False),
)

events = Table(
    "events",
    metadata,
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("at", Double, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("data", Text, nullable=False),
    Index(None, "at"),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("fingerprint", String(64)),
    Column("created_at", Double, nullable=False),
    Column("url", Text, nullable=False),
    Column("topics", Text, nullable=False),
    Column("secret", String(256), nullable=False),
    Column("cursor", BigInteger, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("trying_since", Double),
    Column("next_at", Double, nullable=False),
    Column("last_status", Integer),
    Column("last_error", Text),
    Column("abandoned", Integer, nullable=False),
    Column("claim", String(64)),
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("role", String(16), nullable=False),
    Column("digest", String(64), nullable=False),
    Column("created_at", Double, nullable=False),
    Column("revoked_at", Double),
)

audit = Table(
    "audit",
    metadata,
    Column("id", _Number, primary_key=True, autoincrement=True),
    Column("at", Double, nullable=False),
    Column("principal", String(64), nullable=False),
    Column("role", String(16), nullable=False),
    Column("client", String(64), nullable=False),
    Column("method", String(8), nullable=False),
    Column("path", String(256), nullable=False),
    Column("status", Integer, nullable=False),
    Column("request_id", String(64), nullable=False),
    Index(None, "at"),
)

"""Store which of several services each operation belongs to."""

import sqlalchemy as sa
from alembic import op

revision = "leases"
down_revision = "what_plans_are_held_to"
branch_labels = None
depends_on = None

REQUIRE_LEASE = """
CREATE FUNCTION require_lease(wanted_id text, wanted_token bigint) RETURNS void LANGUAGE plpgsql AS $$
BEGIN
  PERFORM 1 FROM leases WHERE operation_id = wanted_id AND token = wanted_token FOR KEY SHARE;
  IF NOT FOUND THEN
    RAISE EXCEPTION 'operation % belongs to another service: a write under token % is refused', wanted_id, wanted_token
      USING ERRCODE = 'integrity_constraint_violation';
  END IF;
END $$
"""


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "leases",
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.Column("owner", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("beat", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["operation_id"], ["operations.id"], name=op.f("fk_leases_operation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("operation_id", name=op.f("pk_leases")),
    )
    op.create_table(
        "leased_vehicles",
        sa.Column("system_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["operation_id"], ["leases.operation_id"], name=op.f("fk_leased_vehicles_operation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("system_id", name=op.f("pk_leased_vehicles")),
    )
    op.create_index(op.f("ix_leased_vehicles_operation_id"), "leased_vehicles", ["operation_id"], unique=False)
    op.add_column("plans", sa.Column("service", sa.String(length=64)))
    if op.get_bind().dialect.name == "postgresql":
        op.execute(REQUIRE_LEASE)


def downgrade() -> None:
    """Undo the upgrade."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION require_lease(text, bigint)")
    op.drop_column("plans", "service")
    op.drop_index(op.f("ix_leased_vehicles_operation_id"), table_name="leased_vehicles")
    op.drop_table("leased_vehicles")
    op.drop_table("leases")

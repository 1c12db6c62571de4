"""Store what users were measured to get in flight."""

import sqlalchemy as sa
from alembic import op

revision = "measurements"
down_revision = "leases"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "measurements",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.Column("uav_id", sa.String(length=64), nullable=False),
        sa.Column("user_id", sa.String(length=64), nullable=False),
        sa.Column("elapsed_s", sa.Double(), nullable=False),
        sa.Column("rate_bps", sa.Double(), nullable=True),
        sa.Column("sinr_db", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["operation_id"], ["operations.id"], name=op.f("fk_measurements_operation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measurements")),
    )
    op.create_index(op.f("ix_measurements_operation_id"), "measurements", ["operation_id"], unique=False)


def downgrade() -> None:
    """Undo the upgrade."""
    op.drop_index(op.f("ix_measurements_operation_id"), table_name="measurements")
    op.drop_table("measurements")

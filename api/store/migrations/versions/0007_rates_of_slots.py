"""Store what users got in slots that are no longer in memory, in operations without a fixed end."""

import sqlalchemy as sa
from alembic import op

revision = "slot_rates"
down_revision = "measurements"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "slot_rates",
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.Column("slot", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("rates_bps", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["operation_id"], ["operations.id"], name=op.f("fk_slot_rates_operation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("operation_id", "slot", name=op.f("pk_slot_rates")),
    )


def downgrade() -> None:
    """Undo the upgrade."""
    op.drop_table("slot_rates")

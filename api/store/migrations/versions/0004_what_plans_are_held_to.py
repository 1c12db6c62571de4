"""Store what plans are asked to keep, and tell contingencies by what a change must be worth too.

Contingencies that were stored knew no weight and kept no pins; they are made again when they are needed.
"""

import sqlalchemy as sa
from alembic import op

revision = "what_plans_are_held_to"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("plans", sa.Column("asked", sa.Text()))
    op.drop_table("contingencies")
    _create(sa.Column("disruption_weight", sa.Double(), nullable=False))


def downgrade() -> None:
    """Undo the upgrade."""
    op.drop_table("contingencies")
    _create()
    op.drop_column("plans", "asked")


def _create(*more_of_key: sa.Column[float]) -> None:
    key = ("plan_id", "at_slot", "uav_id", *(column.name for column in more_of_key))
    op.create_table(
        "contingencies",
        sa.Column("plan_id", sa.String(length=64), nullable=False),
        sa.Column("at_slot", sa.Integer(), nullable=False),
        sa.Column("uav_id", sa.String(length=64), nullable=False),
        *more_of_key,
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("result", sa.Text(), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["plan_id"], ["plans.id"], name=op.f("fk_contingencies_plan_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint(*key, name=op.f("pk_contingencies")),
    )

"""Store which operation flew a plan as a column, so that clean-up need not parse operations."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.add_column("plans", sa.Column("operation_id", sa.String(length=64)))
    op.create_index(op.f("ix_plans_operation_id"), "plans", ["operation_id"], unique=False)
    op.create_index(op.f("ix_events_at"), "events", ["at"], unique=False)
    op.create_index(op.f("ix_audit_at"), "audit", ["at"], unique=False)
    op.create_index(op.f("ix_operations_ended_at"), "operations", ["ended_at"], unique=False)
    connection = op.get_bind()
    mark = sa.text("UPDATE plans SET operation_id = :operation WHERE id = :plan")
    for row in connection.execute(sa.text("SELECT id, plan_id, document FROM operations")).all():
        flown = {row.plan_id, *(entry["plan_id"] for entry in json.loads(row.document).get("timeline", []))}
        for plan in sorted(flown):
            connection.execute(mark, {"operation": row.id, "plan": plan})


def downgrade() -> None:
    """Undo the upgrade."""
    op.drop_index(op.f("ix_operations_ended_at"), table_name="operations")
    op.drop_index(op.f("ix_audit_at"), table_name="audit")
    op.drop_index(op.f("ix_events_at"), table_name="events")
    op.drop_index(op.f("ix_plans_operation_id"), table_name="plans")
    op.drop_column("plans", "operation_id")

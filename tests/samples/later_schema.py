"""A second revision of the schema, as a later version of the program brings it: one column more, and one table."""

import shutil
from pathlib import Path

from alembic import command
from alembic.config import Config

import migrations
from cbsr_qa.app import database, keeping
from cbsr_qa.store import schema
from cbsr_qa.store.engine import writing
from cbsr_qa.store.sync import centre

LATER = f"{int(schema.REVISIONS[-1]) + 1}"

_SCRIPT = f'''"""Runs say how loud it was."""

import sqlalchemy as sa
from alembic import op

revision = "{LATER}"
down_revision = "{schema.REVISIONS[-1]}"
branch_labels = None
depends_on = None


def upgrade():
    op.add_column("runs", sa.Column("loudness", sa.Text(), nullable=True))
    op.create_table("lots", sa.Column("lot", sa.Text(), primary_key=True))
    op.create_table("cases", sa.Column("case", sa.Text(), primary_key=True))


def downgrade():
    op.drop_table("cases")
    op.drop_table("lots")
    op.drop_column("runs", "loudness")
'''


def add_revision(patch, folder):
    """Have the program read and write the second revision, whose scripts are written into a folder."""
    scripts = Path(folder) / "migrations"
    if not scripts.exists():
        shutil.copytree(Path(migrations.__file__).parent, scripts, ignore=shutil.ignore_patterns("__pycache__"))
        (scripts / "versions" / f"r{LATER}_loudness.py").write_text(_SCRIPT)
    patch.setattr(schema, "SCRIPTS", str(scripts))
    patch.setattr(schema, "REVISIONS", (*schema.REVISIONS, LATER))
    for module in (schema, database, keeping, centre):
        patch.setattr(module, "HEAD", LATER)


def take_back(engine, revision):
    """Take a database back to a revision, or to none (``base``), as only Alembic does."""
    config = Config()
    config.set_main_option("script_location", schema.SCRIPTS)
    with writing(engine) as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, revision)

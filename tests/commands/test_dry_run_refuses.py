"""A dry run is refused where the run would be, with the same words and the same exit code."""

import sqlite3
import sys

import pytest
from command import cbsr_qa, document, short_recipe

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store import schema
from cbsr_qa.store.engine import open_engine, parse_url
from cbsr_qa.store.opening import check_usable, open_store


def station(folder, old, new):
    text = open_document(DocumentKind.STATION, "simulated").text
    assert old in text, old
    (folder / "mine.toml").write_text(text.replace(old, new, 1))


def overdue(folder):
    station(folder, "[indenter]", 'overdue = "refuse"\n\n[indenter]')
    with (folder / "mine.toml").open("a") as file:
        file.write("calibration_due = 2020-01-31\n")


def too_long(folder):
    station(folder, "[safety]", "[safety]\ndwell_s = 30.0")


def unsampled(folder):
    station(folder, "[safety]", "[safety]\ntemperature_C = [18.0, 26.0]")


def worked_by_hand(folder):
    station(
        folder, 'provides = ["frame_source", "force_applicator", "force"]', 'provides = ["frame_source", "force"]'
    )
    with (folder / "mine.toml").open("a") as file:
        file.write(
            '\n[instruments.stand]\ndriver = "manual-applicator"\nprovides = ["force_applicator"]\n'
            'label = "stand"\nserial = "7"\nnumber = "7"\n'
        )


def no_folder(folder):
    (folder / "var").write_text("in the way")


def no_folder_for_reports(folder):
    (folder / "var").mkdir()
    (folder / "var" / "reports").symlink_to("gone")


def unreleased_database(folder):
    engine = open_engine(parse_url(f"sqlite:///{folder / 'var' / 'cbsr-qa.db'}"))
    schema.upgrade(engine)
    engine.dispose()
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '0024'")
    connection.close()


def foreign_database(folder):
    (folder / "var").mkdir()
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as connection:
        connection.execute("CREATE TABLE theirs (one INTEGER)")
    connection.close()


def damaged_database(folder):
    (folder / "var").mkdir()
    (folder / "var" / "cbsr-qa.db").write_bytes(b"SQLite format 3\0" + b"\x10\x00" * 40)


def files(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (overdue, "was due on 2020-01-31"),
        (unreleased_database, "has schema 0024, from before version 0.1.0"),
        (too_long, "the head is down for 60 s; the station allows 30 s"),
        *(
            pytest.param(*other, marks=pytest.mark.rest)
            for other in (
                (no_folder, "folder var/reports cannot be written to"),
                (damaged_database, "cbsr-qa.db"),
                (unsampled, "[safety] temperature_C limits the temperature, but no instrument samples it"),
                (worked_by_hand, "there is no operator to ask"),
                (no_folder_for_reports, "folder var/reports cannot be written to"),
                (foreign_database, "belongs to another program"),
            )
        ),
    ],
)
def test_a_dry_run_is_refused_as_the_run_is_and_neither_writes_anything(tmp_path, prepare, said):
    prepare(tmp_path)
    recipe = short_recipe(tmp_path)
    before = files(tmp_path)
    mine = "mine.toml" if (tmp_path / "mine.toml").exists() else "simulated"
    asked = ["run", "--station", mine, "--recipe", recipe, "--serial", "S-1", "--seed", "1", "--json"]
    run, dry = (cbsr_qa(tmp_path, *asked, *more, check=False) for more in ([], ["--dry-run"]))
    assert (run.returncode, dry.returncode) == (2, 2)
    refused = document(dry)["refused"]
    assert said in refused["reason"]
    assert refused == document(run)["refused"]
    assert files(tmp_path) == before


@pytest.mark.rest
@pytest.mark.skipif(sys.platform != "linux", reason="a file system that takes no files")
def test_a_file_system_that_takes_no_files_is_refused_by_both(tmp_path):
    asked = ["run", "--station", "simulated", "--recipe", short_recipe(tmp_path), "--serial", "S-1", "--seed", "1"]
    there = ["--database", "sqlite:////proc/x.db", "--json"]
    run, dry = (cbsr_qa(tmp_path, *asked, *there, *more, check=False) for more in ([], ["--dry-run"]))
    assert (run.returncode, dry.returncode) == (2, 2)
    assert document(dry)["refused"] == document(run)["refused"]
    assert "/proc/x.db" in document(dry)["refused"]["reason"]


def test_a_dry_run_leaves_neither_database_nor_folder(tmp_path):
    check_usable(f"sqlite:///{tmp_path}/new/folder/x.db")
    assert list(tmp_path.iterdir()) == []


def test_what_the_station_does_not_allow_is_listed_before_the_refusal(tmp_path):
    too_long(tmp_path)
    asked = ["run", "--station", "mine.toml", "--recipe", "nine-locations", "--serial", "S-1", "--dry-run"]
    said = cbsr_qa(tmp_path, *asked, check=False)
    assert said.returncode == 2
    assert "not allowed   phase" in said.stdout
    assert "change the recipe's options" in said.stderr
    listed = document(cbsr_qa(tmp_path, *asked, "--json", check=False))
    assert listed["violations"]
    assert all(one in listed["refused"]["reason"] for one in listed["violations"])


@pytest.mark.postgres
def test_a_database_that_takes_no_rows_is_refused_before_anything_moves(postgres_server, postgres_database):
    check_usable(postgres_database)
    name = postgres_database.rpartition("/")[2]
    read_only = f"ALTER DATABASE {name} SET default_transaction_read_only = "
    for tables in (False, True):
        if tables:
            open_store(postgres_database).close()
            check_usable(postgres_database)
        postgres_server.execute(read_only + "on")
        with pytest.raises(StoreError, match="is read-only"):
            check_usable(postgres_database)
        postgres_server.execute(read_only + "off")

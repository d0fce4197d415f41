"""A plugin that forks and lets the copy come back: the copy ends as it leaves the plugin, and cleans nothing up."""

import os
import signal
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from copied import come_back, fork, fork_and_leave
from simulated_setting import HEAD, material, scene, sensor_type
from stored_runs import journalled, short_run

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.plan.world import Moment, SceneSetting
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind, hookimpl
from cbsr_qa.simulate.chain import build_chain
from cbsr_qa.station.bench import Bench, stop_all
from cbsr_qa.station.event_sinks import Delivery
from cbsr_qa.station.plan import schedule
from cbsr_qa.store.engine import open_engine, parse_url, reading
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.system.files import FileLock, holder
from cbsr_qa.testing.bench import Script, example_plan, make_scripted_bench


class _Plugin:
    """Forks in whatever it is asked for; ``code`` is its own."""

    largest_batch = 1
    perturbs, needs = "force", ()

    def __init__(self, code):
        self.code = code

    def act(self, *given, **named):
        self.code()

    deliver = apply = act

    @hookimpl
    def cbsr_phase_finished(self, phase):
        self.code()

    @hookimpl
    def cbsr_before_run(self, serial=""):
        self.code()

    def steps(self, context):
        yield from (self.code() for _ in "x")

    def close(self):
        pass


def _hooks(code):
    plugins = Plugins()
    plugins.manager.register(_Plugin(code))
    return plugins


def _tell(code):
    _hooks(code).tell("cbsr_phase_finished", lambda words: None, phase="first", identity=None)


def _factory(code):
    plugins = SimpleNamespace(factory=lambda kind, name: code)
    create_plugin(plugins, Kind.METRIC, PluginChoice("theirs"), "[metrics]")


def _sequence(code):
    plan = example_plan([])
    schedule(replace(plan, phases=(replace(plan.phases[0], sequence=_Plugin(code)),)))


def _effect(code):
    setting = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
    chain = build_chain(scene("theirs"), setting, lambda name: lambda setting: _Plugin(code))
    chain.apply("force", Moment(setting, 12.5, 0, [], [0.1], [1.0]))


def _identity(code):
    bench = make_scripted_bench(Script(VirtualClock()), example_plan([]).sensor_type)
    bench.mounted[0].instrument.identity = code
    Bench.identities(bench)


def _safe_state(code):
    stop_all([("theirs", code)])


def _sink(code):
    delivery = Delivery("theirs", _Plugin(code))
    delivery.put({})
    delivery.end()
    delivery.wait(10.0)


_PLACES = (_tell, _factory, _sequence, _effect, _identity, _safe_state, _sink)


@pytest.mark.parametrize(
    "code", [pytest.param(fork, id="returns", marks=pytest.mark.rest), pytest.param(fork_and_leave, id="raises")]
)
@pytest.mark.parametrize("place", _PLACES)
def test_one_process_comes_back_from_a_plugin(place, code):
    assert come_back(fork) == 2, "the copies are not seen"
    assert come_back(lambda: place(code)) == 1


def test_a_copy_neither_reads_nor_stores_and_leaves_the_original_its_database(database_url):
    with open_store(database_url) as store:
        run = store.new_id()
        begun, *events = short_run(run)
        journal = journalled(store, [begun])
        out, into = os.pipe()
        if (copy := fork()) == 0:
            said = []
            for act in (lambda: journal(events[0]), lambda: store.analyses.load(run)):
                try:
                    act()
                except StoreError as error:
                    said.append(error.reason)
            os.write(into, "\n".join(said).encode())
            os._exit(0)
        os.close(into)
        os.waitpid(copy, 0)
        with os.fdopen(out, "rb") as pipe:
            refusals = pipe.read().decode().splitlines()
        assert len(refusals) == 2
        for reason in refusals:
            assert f"was opened by process {os.getpid()}, of which process {copy} is a forked copy" in reason
        for event in events:
            journal(event)
        assert len(store.runs.load(run).phases) == 2


def test_a_copy_that_opens_the_database_itself_may_read_it(database_url):
    with open_store(database_url) as store:
        journalled(store, short_run(store.new_id()))
    found = 0
    if (copy := fork()) == 0:
        try:
            engine = open_engine(parse_url(database_url))
            with reading(engine) as connection:
                found = len(connection.exec_driver_sql("SELECT run FROM runs").all())
        finally:
            os._exit(found)
    assert os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]) == 1


def test_a_copy_releases_no_lock(tmp_path):
    lock = FileLock(tmp_path / "lock", b"Kim")
    if (copy := fork()) == 0:
        try:
            lock.release()
        finally:
            os._exit(0)
    os.waitpid(copy, 0)
    assert holder(tmp_path / "lock") == b"Kim"
    lock.release()
    assert holder(tmp_path / "lock") is None


def test_a_copy_that_outlives_a_killed_process_holds_no_lock(tmp_path):
    out, into = os.pipe()
    if (process := fork()) == 0:
        try:
            lock = FileLock(tmp_path / "lock", b"Kim")
            copy = fork() or os.getpid()
            if copy != os.getpid():
                os.write(into, b"%d " % copy)
            time.sleep(60)
            lock.release()
        finally:
            os._exit(0)
    copy = int(os.read(out, 64))
    try:
        assert holder(tmp_path / "lock") == b"Kim"
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        os.kill(copy, 0)  # lives on
        assert holder(tmp_path / "lock") is None
        FileLock(tmp_path / "lock", b"Ada").release()
    finally:
        os.kill(copy, signal.SIGKILL)
        os.close(out)
        os.close(into)


def test_a_copy_drives_no_instrument():
    def close_twice():
        bench = make_scripted_bench(Script(VirtualClock()), example_plan([]).sensor_type)
        fork()
        bench.close()

    assert come_back(close_twice) == 1

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.core.workers.toy_runners import ToyRunner
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ResourceError, SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.executors import LostJobError, WorkerBugError, run_all
from yamsim_cli.recording.executor_factories import ray_executor
from yamsim_cli.recording.ray_pool import RayPool


def test_without_ray_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ResourceError, match=r"^--executor ray needs the package ray: pip install 'yamsim\[ray\]'$"):
        RayPool[int, object](ToyRunner, 1)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A head without a CPU, and two nodes with one each, so that a node can be lost."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    nodes = [made.add_node(num_cpus=1) for _ in range(2)]
    try:
        yield made, nodes
    finally:
        made.shutdown()


@pytest.fixture
def open_pool(cluster: Any) -> Any:
    made, _ = cluster

    def open_(workers: int = 2, **options: Any) -> RayPool[int | str, Any]:
        return RayPool(ToyRunner, workers, address=made.address, **options)

    return open_


@pytest.mark.slow
class TestOnACluster:
    def test_every_job_comes_back_from_another_process(self, open_pool: Any) -> None:
        with open_pool() as pool:
            assert dict(run_all(pool, range(10))) == {k: k * k for k in range(10)}
            pool.submit("pid")
            assert pool.next_result()[1] != os.getpid()

    def test_errors_and_bugs_reach_the_caller(self, open_pool: Any) -> None:
        with open_pool(1) as pool:
            pool.submit("error")
            with pytest.raises(SimulationError, match="the toy is broken"):
                pool.next_result()
            pool.submit("bug")
            with pytest.raises(WorkerBugError, match="ZeroDivisionError: nobody expected"):
                pool.next_result()

    @pytest.mark.parametrize("job", ["die", "sleep"])
    def test_a_job_that_ends_every_actor_is_given_up_and_the_rest_goes_on(self, open_pool: Any, job: str) -> None:
        with open_pool(2, job_seconds=1.0) as pool:
            pool.submit(job)
            with pytest.raises(LostJobError, match=f"^{job} "):
                pool.next_result()
            pool.submit(7)
            assert pool.next_result() == (7, 49)

    def test_a_node_that_would_draw_otherwise_is_refused_at_the_start(
        self, cluster: Any, config: RecordConfig, locations: Locations
    ) -> None:
        """For example because its meshes or its yamsim differ from the recorder's."""
        noted = config.model_copy(update={"meshes": {"i2rt_yam_crank": "full " + "0" * 64, "ycb": "primitives"}})
        with ray_executor(Session(noted, locations), 1, cluster[0].address) as executor:
            executor.submit(AttemptJob(0, 0))
            with pytest.raises(ResourceError, match="i2rt_yam_crank: full 0"):
                executor.next_result()

    def test_more_workers_than_cpus_are_refused(self, open_pool: Any) -> None:
        with pytest.raises(ResourceError, match="has 2 CPUs, and 3 workers need one each"):
            open_pool(3)

    def test_signals_keep_their_meaning(self, open_pool: Any) -> None:
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        with open_pool(1):
            assert {number: signal.getsignal(number) for number in before} == before

    def test_variables_reach_the_actors(self, open_pool: Any) -> None:
        with open_pool(1, environ={"YAMSIM_TOY": "painted"}) as pool:
            pool.submit("variable:YAMSIM_TOY")
            assert pool.next_result()[1] == "painted"

    def test_a_lost_node_costs_only_what_was_in_flight(self, cluster: Any, open_pool: Any) -> None:
        made, nodes = cluster
        with open_pool(2) as pool:
            done = {}
            for job, result in run_all(pool, range(40)):
                done[job] = result
                if len(done) == 10:
                    made.remove_node(nodes.pop(), allow_graceful=False)
            assert done == {k: k * k for k in range(40)}
        nodes.append(made.add_node(num_cpus=1))

    @pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1"])
    def test_no_cluster_at_the_address_is_said(self, address: str) -> None:
        pytest.importorskip("ray")
        with pytest.raises(ResourceError, match=rf"^no Ray cluster at {address}: .*refused; start one with `ray start"):
            RayPool[int, object](ToyRunner, 1, address=address)

"""What the service never does with what others send: unpickle, evaluate, connect, parse XML."""

from __future__ import annotations

from source_tree import modules

CODE_FROM_DATA = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "xml"}
MAY_PICKLE = {"service.workers.link", "service.recordings.forked_workers"}
"""Modules that may unpickle: they talk to the service's own workers, never to a client"""
EVALUATING = {"eval", "exec", "compile", "os.system", "os.popen"}
NETWORK = {"urllib.request", "http.client", "ftplib", "smtplib", "requests", "httpx", "httpx2"}
CONNECTING = {"socket.create_connection", "asyncio.open_connection", "connect"}
MAY_CONNECT = {"service.api.replicas"}
"""Modules that may connect: to the addresses of the setting ``peers``, never to a client's"""


def test_pickle_is_only_spoken_between_the_service_and_its_own_workers() -> None:
    found = {
        (module, name.split(".")[0])
        for module, source in modules("service").items()
        for name in source.imports
        if name.split(".")[0] in CODE_FROM_DATA
    }
    assert found == {(module, "pickle") for module in MAY_PICKLE}


def test_arrays_are_loaded_without_pickle_and_nothing_is_evaluated() -> None:
    offenders = {
        f"{module} calls {name}"
        for module, source in modules("service").items()
        for name, keywords in source.calls
        if name in EVALUATING
        or keywords.get("shell", "False") != "False"
        or (name in ("np.load", "numpy.load") and keywords.get("allow_pickle") != "False")
    }
    assert not offenders


def test_the_service_connects_to_nobody_but_its_own_replicas() -> None:
    connecting = {
        module
        for module, source in modules("service").items()
        for name in [*source.imports, *(name for name, _ in source.calls)]
        if name in CONNECTING or any(f"{name}.".startswith(f"{each}.") for each in NETWORK)
    }
    assert connecting == MAY_CONNECT

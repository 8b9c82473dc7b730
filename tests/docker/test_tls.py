"""TLS by the proxy: recordings and streams through a certificate that the client checks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import soundfile
from container_engine import run
from running_containers import ARRAY, SAMPLE, TALKERS_DEG, ComposeProject, wait_for

from neuralmusic import LocalizationClient, StreamClient

pytestmark = pytest.mark.docker


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    """A certificate for 127.0.0.1 that nobody but this test trusts."""
    return new_certificate(tmp_path / "ca.pem", tmp_path / "served")


def new_certificate(certificate: Path, folder: Path) -> Path:
    """A self-signed certificate; the folder has it with its key, for the proxy."""
    key = certificate.with_suffix(".key")
    words = "req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=robots -addext subjectAltName="
    made = ("-keyout", str(key), "-out", str(certificate))
    run("openssl", *f"{words}IP:127.0.0.1".split(), *made)
    folder.mkdir(exist_ok=True)
    served = folder / "site.pem"
    served.write_text(certificate.read_text() + key.read_text())
    served.chmod(0o644)  # the proxy's user is another one
    for each in (folder, folder.parent):
        each.chmod(0o755)
    return certificate


def test_https_and_wss_go_through_the_proxy(
    image: str,
    provided: Callable[[str], None],
    certificate: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    provided("haproxy:2.6")
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    files = ("compose.scale.yaml", "compose.tls.yaml")
    folder = certificate.parent / "served"
    with ComposeProject("tls", *files, REPLICAS="1", CERTIFICATES=folder) as project:
        project.up()
        url = project.url("proxy", 8443, "https")
        wait_for(f"{url}/readyz")
        with LocalizationClient(url) as client:
            answer = client.localize(SAMPLE, array=ARRAY)
        found = sorted(source["azimuth_deg"] for source in answer["summary"]["sources"])
        assert found == pytest.approx(TALKERS_DEG, abs=4.0)

        audio, rate = soundfile.read(SAMPLE, dtype="int16")
        form = {"encoding": "pcm_s16le", "sample_rate": rate, "channels": 4}
        with StreamClient(url, array=ARRAY, audio=form, overflow="block") as stream:
            stream.send(audio[:rate])
            assert stream.stop().audio_s == pytest.approx(1.0)

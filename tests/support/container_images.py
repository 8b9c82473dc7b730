"""The images of the tests: the service's own, and those that it is built on and runs beside.

An image that the engine has is used as it is, one that can be pulled is pulled. Where there is no
registry, stand-ins with the same names, users and paths are made of Debian's packages: the base
image by debootstrap, trimmed as Debian's slim images are.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from container_engine import answers, docker, run

BASE = "debian:bookworm-slim"
SERVICE = "neuralmusic"
CODENAME = "bookworm"
PULL_S = 300
STAND_IN = "org.neuralmusic.stand-in"
"""Label of images that are not official"""
UNWANTED = ("doc", "man", "info", "locale", "lintian", "groff")
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
OWN_CERTIFICATES = Path("/usr/local/share/ca-certificates")
PIP_NETWORK = (
    *("index-url", "extra-index-url", "trusted-host", "cert", "proxy"),
    *("timeout", "default-timeout", "retries"),
)
"""pip's settings that concern the network alone"""

HAPROXY = f"""
FROM {BASE}
LABEL {STAND_IN}=true
RUN apt-get update && apt-get install -y --no-install-recommends haproxy \\
    && usermod -u 99 haproxy && rm -rf /var/lib/apt/lists/* \\
    && printf '%s\\n' '#!/bin/sh' 'set -e' '[ "$1" != haproxy ] || shift' \\
       'exec haproxy -W -db "$@"' > /usr/local/bin/docker-entrypoint.sh \\
    && chmod +x /usr/local/bin/docker-entrypoint.sh
STOPSIGNAL SIGUSR1
USER haproxy
WORKDIR /var/lib/haproxy
ENTRYPOINT ["docker-entrypoint.sh"]
CMD ["haproxy", "-f", "/usr/local/etc/haproxy/haproxy.cfg"]
"""
PROMETHEUS = f"""
FROM {BASE}
LABEL {STAND_IN}=true
RUN apt-get update && apt-get install -y --no-install-recommends prometheus \\
    && rm -rf /var/lib/apt/lists/* && install -d -o nobody /prometheus
USER nobody
WORKDIR /prometheus
ENTRYPOINT ["/bin/prometheus"]
CMD ["--config.file=/etc/prometheus/prometheus.yml", "--storage.tsdb.path=/prometheus"]
"""
STAND_INS = {"haproxy": HAPROXY, "prom/prometheus": PROMETHEUS}


def present(image: str) -> bool:
    """Whether the engine has an image."""
    return answers("docker", "image", "inspect", image)


def provide(image: str) -> str | None:
    """Have an image; None, or a sentence on why there is none."""
    if present(image) or pulled(image):
        return None
    if image == BASE:
        return make_base()
    recipe = STAND_INS.get(image.partition(":")[0])
    if recipe is None:
        return f"{image} cannot be pulled, and there is no stand-in for it"
    missing = provide(BASE)
    if missing is None:
        build("-t", image, "-", stdin=recipe.encode())
    return missing


def pulled(image: str) -> bool:
    try:
        done = subprocess.run(
            ["docker", "pull", "-q", image], capture_output=True, timeout=PULL_S, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def build_service() -> None:
    """The service's image from this tree; what did not change comes from the engine's cache."""
    build("-f", "docker/Dockerfile", "-t", SERVICE, ".")


def build(*words: str, stdin: bytes | None = None) -> None:
    docker("build", "-q", "--network", "host", *words, stdin=stdin)


def make_base() -> str | None:
    """Debian's minimal system as an image; None, or a sentence on why there is none."""
    if shutil.which("debootstrap") is None:
        return f"{BASE} cannot be pulled, and without debootstrap none can be made"
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "root"
        sources = debian_sources()
        run("debootstrap", "--variant=minbase", CODENAME, str(root), sources[0].split()[1])
        trim(root)
        settle(root, sources)
        # From a program to the next: the archive is too large for a pipe that is read at the end.
        archive = Path(folder) / "root.tar"
        run("tar", "-C", str(root), "-cf", str(archive), ".")
        label = ("-c", f"LABEL {STAND_IN}=true", "-c", 'CMD ["bash"]')
        docker("import", *label, str(archive), BASE)
    return None


def debian_sources() -> list[str]:
    """Lines of apt's sources: those of this machine for Debian's release, its own first."""
    form = "deb $(REPO_URI) $(RELEASE) $(COMPONENT)"
    printed = run("apt-get", "indextargets", "--format", form, "Created-By: Packages")
    releases = (CODENAME, f"{CODENAME}-updates", f"{CODENAME}-security")
    lines = [line for line in printed.splitlines() if line.split()[2] in releases]
    return sorted(set(lines), key=lambda line: (releases.index(line.split()[2]), line))


def trim(root: Path) -> None:
    """Leave out what Debian's slim images leave out, now and in later installations."""
    excluded = []
    for name in UNWANTED:
        shutil.rmtree(root / "usr/share" / name, ignore_errors=True)
        excluded.append(f"path-exclude /usr/share/{name}/*")
    (root / "etc/dpkg/dpkg.cfg.d/docker").write_text("\n".join(excluded) + "\n")
    for name in ("var/cache/apt", "var/lib/apt/lists", "var/log"):
        shutil.rmtree(root / name, ignore_errors=True)
        (root / name).mkdir()
    clean = 'DPkg::Post-Invoke { "rm -f /var/cache/apt/archives/*.deb /var/cache/apt/*.bin"; };\n'
    (root / "etc/apt/apt.conf.d/docker-clean").write_text(clean)


def settle(root: Path, sources: list[str]) -> None:
    """What makes apt and pip work in this machine's network: sources, certificates, pip's index."""
    (root / "etc/apt/sources.list").write_text("\n".join(sources) + "\n")
    settings = run("apt-config", "dump").splitlines()
    network = re.compile(r"Acquire::(Check-|Retries|https?::)")
    kept = [line for line in settings if network.match(line) and not line.endswith('"";')]
    (root / "etc/apt/apt.conf.d/99network").write_text("\n".join(kept) + "\n")
    if CERTIFICATES.exists():
        (root / "etc/ssl/certs").mkdir(parents=True, exist_ok=True)
        shutil.copy(CERTIFICATES, root / CERTIFICATES.relative_to("/"))
    if OWN_CERTIFICATES.is_dir():
        target = root / OWN_CERTIFICATES.relative_to("/")
        shutil.copytree(OWN_CERTIFICATES, target, dirs_exist_ok=True)
    (root / "etc/pip.conf").write_text(pip_settings())


def pip_settings() -> str:
    """pip's settings of this machine that reach its index; the image has none of its folders."""
    settings = {}
    for line in run(sys.executable, "-m", "pip", "config", "list").splitlines():
        name, _, value = line.partition("=")
        key = name.rpartition(".")[2]
        shared = name.startswith((":env:.", "global.")) and "file:" not in value
        if shared and key in PIP_NETWORK:
            settings[key] = value.strip("'")
    return "\n".join(["[global]", *(f"{key} = {value}" for key, value in settings.items()), ""])


def size_bytes(image: str) -> int:
    """Bytes of all layers, as ``docker images`` shows them."""
    return int(docker("image", "inspect", "-f", "{{.Size}}", image))

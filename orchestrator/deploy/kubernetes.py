"""A network as Kubernetes manifests, with the config of each process in them."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml

from hedgerow.agents.law_source import LawSource
from hedgerow.orchestrator.deploy.containers import (
    AGENT_MEMORY,
    CPUS,
    HOMES,
    KEYS,
    LAW,
    OBSERVER_MEMORY,
    OBSERVERS,
    PAGE_CHECK,
    PAGE_PORT,
    PLANT_MEMORY,
    ROUTER_IMAGE,
    ROUTER_MEMORY,
    ROUTER_PORT,
    ROUTERS,
    TEMPORARY,
    Containers,
    Files,
)
from hedgerow.topologies.regular_file import read_regular
from hedgerow.topologies.resolve import to_yaml
from hedgerow.wire import keys
from hedgerow.wire.access import ROUTER

NO_LAW = LawSource()
MOST_MAP_BYTES = 1_000_000
"""The maximum size of a ConfigMap; the limit of Kubernetes is 1 MiB."""
USER_ID = 10001
"""The user in both images (Dockerfile)."""


def to_kubernetes(one: Containers) -> str:
    """Return Kubernetes manifests: a Deployment and a Service for the router, a Job and a ConfigMap for each
    process.
    """
    name = one.topology.name
    originals = {service: home for home, service in one.services.items()}
    documents: list[Mapping[str, Any]] = [*_secrets(one, name, ROUTERS), *_router(one, name), *_law(one, name)]
    for config in one.configs:
        again, own = config.process != keys.PLANT, one.own(config)
        mounted = _mounted(one, own)
        documents += [
            *_secrets(one, name, own),
            _config_map(name, config.process, "config.toml", config.to_toml(), originals[config.process]),
            _job(
                name,
                config.process,
                one.image("hedgerow-agent"),
                one.command(config),
                one.check(config),
                again,
                mounted,
                originals[config.process],
                one.law if again else NO_LAW,
            ),
        ]
    check = list(PAGE_CHECK)
    command = one.observer("/config/topology.yaml")
    documents += [
        *_secrets(one, name, OBSERVERS),
        _config_map(name, "orchestrator", "topology.yaml", to_yaml(one.topology)),
        _volume_claim(name),
        _job(name, "orchestrator", one.image("hedgerow"), command, check, False, _mounted(one, OBSERVERS), law=one.law),
        _page(name),
    ]
    return HEAD_KUBERNETES.format(name=label(name), page=PAGE_PORT) + yaml.safe_dump_all(
        documents, sort_keys=False, width=10**6, explicit_start=True
    )


HEAD_KUBERNETES = """\
# Made by `orchestrator compose --format kubernetes`; the images are those of the Dockerfile.
#   kubectl create namespace {name} && kubectl apply -n {name} -f THIS-FILE
#   kubectl port-forward -n {name} service/page {page}      the page is at http://localhost:{page}
#   kubectl delete namespace {name}
"""
SECURITY = {
    "allowPrivilegeEscalation": False,
    "capabilities": {"drop": ["ALL"]},
    "readOnlyRootFilesystem": True,
    "seccompProfile": {"type": "RuntimeDefault"},
}


def _resources(megabytes: int) -> dict[str, Any]:
    limits = {"memory": f"{megabytes}Mi", "cpu": str(CPUS)}
    return {"requests": {"memory": "64Mi", "cpu": "50m"}, "limits": limits}


def _temporary(paths: Sequence[str]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the mounts and volumes of folders that end with the pod."""
    mounts = [{"name": f"temporary-{k}", "mountPath": path} for k, path in enumerate(paths)]
    volumes = [{"name": mount["name"], "emptyDir": {"sizeLimit": "256Mi"}} for mount in mounts]
    return mounts, volumes


def label(text: str) -> str:
    """Return a name for `text` that Kubernetes accepts everywhere: an RFC 1123 label of 1 to 63 characters.

    A text that is such a label remains unchanged. Another text gets a hash at its end, so two texts never get one name.
    `default` and `kube-…` are namespaces of Kubernetes itself, which our instructions would delete.
    """
    if _LABEL.fullmatch(text) and text != "default" and not text.startswith("kube-"):
        return text
    digest = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:10]
    stem = _NOT_OF_LABELS.sub("-", text.lower())[: _MOST_LABEL - len(digest) - 1].strip("-")
    if stem == "kube" or stem.startswith("kube-"):
        stem = f"net-{stem}"[: _MOST_LABEL - len(digest) - 1].strip("-")
    return f"{stem}-{digest}" if stem else digest


_MOST_LABEL = 63
_LABEL = re.compile(r"[a-z0-9]([-a-z0-9]{0,61}[a-z0-9])?")
_NOT_OF_LABELS = re.compile(r"[^a-z0-9]+")


def _meta(network: str, process: str, original: str = "") -> dict[str, Any]:
    """Return the name and the labels of an object, with the original texts of changed ones."""
    names = {"hedgerow/network": (network, label(network)), "hedgerow/process": (original or process, label(process))}
    changed = {key: text for key, (text, name) in names.items() if text != name}
    annotations = {"annotations": changed} if changed else {}
    return {"name": label(process), "labels": _labels(network, process), **annotations}


def _labels(network: str, process: str) -> dict[str, str]:
    return {
        "app.kubernetes.io/name": "hedgerow",
        "app.kubernetes.io/instance": label(network),
        "hedgerow/process": label(process),
    }


Keys = Mapping[str, str]
"""The folders of keys in a container, and the Secrets that hold them."""


def _mounted(one: Containers, files: Files) -> Keys:
    return {home: one.services.get(home, home) for home in files} if one.keys else {}


def _secrets(one: Containers, network: str, files: Files) -> Iterator[Mapping[str, Any]]:
    """Yield a Secret for each of the folders of keys."""
    for home, secret in _mounted(one, files).items():
        assert one.keys is not None
        held = {file: base64.b64encode(read_regular(one.keys / home / file)).decode() for file in files[home]}
        yield {"apiVersion": "v1", "kind": "Secret", "metadata": _meta(network, secret), "data": held}


def _key_volumes(own: Keys) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the mounts of a container, and the volumes of its pod; only it and its group can read them."""
    mounts = [
        {"name": label(f"keys-{secret}"), "mountPath": f"{KEYS}/{home}", "readOnly": True}
        for home, secret in own.items()
    ]
    volumes = [
        {"name": label(f"keys-{secret}"), "secret": {"secretName": label(secret), "defaultMode": 0o440}}
        for secret in own.values()
    ]
    return mounts, volumes


def _router(one: Containers, network: str) -> list[Mapping[str, Any]]:
    labels = _labels(network, "router")
    container: dict[str, Any] = {
        "name": "router",
        "image": ROUTER_IMAGE,
        "args": list(one.router_command),
        "ports": [{"containerPort": ROUTER_PORT}],
        "readinessProbe": {"tcpSocket": {"port": ROUTER_PORT}, "periodSeconds": 2},
        "livenessProbe": {"exec": {"command": list(one.router_check)}, "periodSeconds": 10, "timeoutSeconds": 5},
        "securityContext": SECURITY,
        "resources": _resources(ROUTER_MEMORY),
    }
    spec: dict[str, Any] = {"containers": [container], "automountServiceAccountToken": False}
    container["volumeMounts"], spec["volumes"] = _temporary([TEMPORARY])
    if own := _mounted(one, ROUTERS):
        container["workingDir"] = f"{KEYS}/{ROUTER}"
        mounts, volumes = _key_volumes(own)
        container["volumeMounts"] += mounts
        spec["volumes"] += volumes
    pod = {"metadata": {"labels": labels}, "spec": spec}
    return [
        {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": _meta(network, "router"),
            "spec": {"replicas": 1, "selector": {"matchLabels": labels}, "template": pod},
        },
        _a_service(network, "router", "router", ROUTER_PORT),
    ]


def _a_service(network: str, name: str, process: str, port: int) -> Mapping[str, Any]:
    spec = {"selector": _labels(network, process), "ports": [{"port": port, "targetPort": port}]}
    return {"apiVersion": "v1", "kind": "Service", "metadata": _meta(network, name), "spec": spec}


def _page(network: str) -> Mapping[str, Any]:
    return _a_service(network, "page", "orchestrator", PAGE_PORT)


def _config_map(network: str, process: str, file: str, text: str, original: str = "") -> Mapping[str, Any]:
    meta = _meta(network, process, original)
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": {file: text}}


def _law(one: Containers, network: str) -> Iterator[Mapping[str, Any]]:
    """Yield a ConfigMap with the files of the user's law, if there are any."""
    if one.law.files:
        data = {f"file-{k}": base64.b64encode(text).decode() for k, text in enumerate(one.law.files.values())}
        yield {"apiVersion": "v1", "kind": "ConfigMap", "metadata": _meta(network, "law"), "binaryData": data}


def _volume_claim(network: str) -> Mapping[str, Any]:
    spec = {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "1Gi"}}}
    return {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "metadata": _meta(network, "runs"), "spec": spec}


def _job(
    network: str,
    process: str,
    image: str,
    command: Sequence[str],
    check: Sequence[str],
    again: bool,
    own: Keys,
    original: str = "",
    law: LawSource = NO_LAW,
) -> Mapping[str, Any]:
    """Return the job of one process, with a restart after a failure if `again`; its ConfigMap holds only its own
    config.

    `own` are its folders of keys, `original` is the name of the process outside of Kubernetes.
    """
    key_mounts, key_volumes = _key_volumes(own)
    observer = process == "orchestrator"
    mounts, temporary = _temporary([TEMPORARY, *(HOMES if observer else ())])
    memory = OBSERVER_MEMORY if observer else PLANT_MEMORY if process == keys.PLANT else AGENT_MEMORY
    container: dict[str, Any] = {
        "name": label(process),
        "image": image,
        "command": list(command) if observer else [*command, "--config", "/config/config.toml"],
        "readinessProbe": {
            "exec": {"command": list(check) if observer else [*check, "--config", "/config/config.toml"]},
            "periodSeconds": 10,
            "timeoutSeconds": 10,
        },
        "volumeMounts": [{"name": "config", "mountPath": "/config", "readOnly": True}, *key_mounts, *mounts],
        "securityContext": SECURITY,
        "resources": _resources(memory),
    }
    volumes: list[dict[str, Any]] = [
        {"name": "config", "configMap": {"name": label(process)}},
        *key_volumes,
        *temporary,
    ]
    if law.files:
        container["env"] = [{"name": "PYTHONPATH", "value": LAW}]
        container["volumeMounts"].append({"name": "law", "mountPath": LAW, "readOnly": True})
        items = [{"key": f"file-{k}", "path": path} for k, path in enumerate(law.files)]
        volumes.append({"name": "law", "configMap": {"name": "law", "items": items}})
    if observer:
        container["ports"] = [{"containerPort": PAGE_PORT}]
        container["volumeMounts"].append({"name": "runs", "mountPath": "/home/hedgerow/runs"})
        volumes.append({"name": "runs", "persistentVolumeClaim": {"claimName": "runs"}})
    pod = {
        "restartPolicy": "OnFailure" if again else "Never",
        "automountServiceAccountToken": False,
        "securityContext": {"runAsNonRoot": True, "runAsUser": USER_ID, "fsGroup": USER_ID},
        "containers": [container],
        "volumes": volumes,
    }
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": _meta(network, process, original),
        "spec": {
            "backoffLimit": 6 if again else 0,
            "template": {"metadata": {"labels": _labels(network, process)}, "spec": pod},
        },
    }

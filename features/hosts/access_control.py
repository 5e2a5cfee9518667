"""Rights of each process in a guarded network: zenoh access control as data.

Routers ask every process for its certificate and let pass what the table below allows; all else is
dropped. A rule holds where its key includes the key of the message, so that each list is read as
"these and nothing wider".
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from concord.nodes.bounds import MAX_FRAME_BYTES, MAX_MESSAGE_BYTES
from concord.runtime.network.links import ENVIRONMENT, RECORDER

MONITOR, OPERATOR, ROUTER_NAME = "monitor", "operator", "router"
_SUBSCRIBING = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
_DELIVERED = (
    "put",
    "declare_subscriber",
    "liveliness_token",
    "declare_queryable",
    "query",
    "reply",
)
_KINDS = ("hello", "bid", "share", "estimate", "timing", "unreachable")
# Retransmissions, to processes that wait and to the recorder (`runtime/processes/republisher.py`).
_REPEATED = ("again/", "keep/")
_EVERYTHING = tuple(dict.fromkeys((*_SUBSCRIBING, *_DELIVERED)))


class Rights(NamedTuple):
    """The rights of one process, as topics below `concord/<run>/`."""

    says: tuple[str, ...] = ()
    is_ready: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


def certificate_name(node: int) -> str:
    """The name in the certificate of a node."""
    return f"node-{node}"


def rights(nodes: int) -> dict[str, Rights]:
    """The rights of each process of a network of `nodes` nodes, by the name in its certificate.

    Routers are not listed: what they pass on between hosts has been checked where it came in.
    """
    table = {certificate_name(node): _rights_of_node(node) for node in range(nodes)}
    table[ENVIRONMENT] = Rights(
        says=tuple(
            f"{below}{topics}"
            for below in ("", *_REPEATED)
            for topics in (
                "start", "measured/*", "grant", "truth", "finished", "end", "event", "gone",
                "gone/*", "welcome/*",
            )
        ),
        is_ready=(f"ready/{ENVIRONMENT}",),
        hears=(
            "hello/*", "bid/*", "estimate/*", "recorded/*", "unreachable/*", "end", "ready/*",
            "again/hello/*", "again/bid/*", "again/estimate/*",
        ),
        answers=("state", "control", "clock"),
    )  # fmt: skip
    table[RECORDER] = Rights(
        says=("end", "recorded/*", "watch/**"),
        is_ready=(f"ready/{RECORDER}",),
        hears=("**",),
        answers=("handover",),
        asks=("state",),
    )
    table[MONITOR] = Rights(hears=("**",), asks=("state", "handover"))
    table[OPERATOR] = Rights(hears=("**",), asks=("state", "handover", "control"))
    return table


def _rights_of_node(node: int) -> Rights:
    return Rights(
        says=tuple(f"{below}{kind}/{node}" for below in ("", *_REPEATED) for kind in _KINDS),
        is_ready=(f"ready/{node}",),
        hears=(
            "start", f"measured/{node}", "grant", "share/*", "end", "ready/*", "gone",
            f"gone/{node}", f"welcome/{node}", f"recorded/{node}", f"again/measured/{node}",
            "again/grant", "again/share/*",
        ),
        asks=("state", "clock"),
    )  # fmt: skip


def access_control(nodes: int, routers: Sequence[str] = (ROUTER_NAME,)) -> dict[str, Any]:
    """The `access_control` part of a router's zenoh configuration; nobody unnamed may do anything.

    `routers` are the names in the certificates of the network's routers.
    """
    rules: list[dict[str, Any]] = [
        _rule("delivered", "egress", _DELIVERED, ("**",)),
        _rule("between routers", "ingress", _EVERYTHING, ("**",)),
        _rule("to routers", "egress", _EVERYTHING, ("**",)),
    ]
    subjects = [{"id": "routers", "cert_common_names": list(routers)}]
    policies = [{"subjects": ["routers"], "rules": ["between routers", "to routers"]}]
    for name, allowed in rights(nodes).items():
        own = [
            _rule(f"{name} {what}", "ingress", messages, topics)
            for what, messages, topics in (
                ("says", ("put",), allowed.says),
                ("is ready", ("liveliness_token",), allowed.is_ready),
                ("hears", _SUBSCRIBING, allowed.hears),
                ("answers", ("declare_queryable", "reply"), allowed.answers),
                ("asks", ("query",), allowed.asks),
            )
            if topics
        ]
        rules += own
        subjects.append({"id": name, "cert_common_names": [name]})
        granted = ["delivered", *(rule["id"] for rule in own)]
        policies.append({"subjects": [name], "rules": granted})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def size_limits() -> list[dict[str, Any]]:
    """The `low_pass_filter` part of a router's zenoh configuration: what is longer is dropped."""
    return [
        {
            "id": name,
            "flows": ["ingress"],
            "messages": ["put"],
            "key_exprs": [f"concord/*/{topics}"],
            "size_limit": limit,
        }
        for name, topics, limit in (
            ("frames", "share/*", MAX_FRAME_BYTES),
            ("repeated frames", "*/share/*", MAX_FRAME_BYTES),
            ("messages", "**", MAX_MESSAGE_BYTES),
        )
    ]


def _rule(name: str, flow: str, messages: Sequence[str], topics: Sequence[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": [f"concord/*/{topic}" for topic in topics],
    }

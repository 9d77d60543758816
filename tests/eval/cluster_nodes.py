"""A Ray cluster of two nodes on loopback, as a process of its own.

Prints the cluster's address and the second node's id; a line on standard input kills that node,
the input's end stops the cluster. So it stops with the process that started it, whatever happens
to that one.
"""

import sys

from ray.cluster_utils import Cluster

NODE = {
    "node_ip_address": "127.0.0.1",
    "num_cpus": 1,
    "object_store_memory": 80 * 2**20,
}


def main() -> None:
    cluster = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
    try:
        second = cluster.add_node(**NODE)
        print(cluster.address, second.node_id, flush=True)
        if sys.stdin.readline():
            cluster.remove_node(second, allow_graceful=False)
            print("killed", flush=True)
            sys.stdin.read()
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()

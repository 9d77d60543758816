"""A Ray cluster on loopback, as a process of its own.

Prints the cluster's address. The line "add" on standard input starts a second node, whose id is
printed; "kill" kills it; the input's end stops the cluster. So it stops with the process that
started it, whatever happens to that one.
"""

import sys

from ray.cluster_utils import Cluster

NODE = {"node_ip_address": "127.0.0.1", "num_cpus": 1, "object_store_memory": 80 * 2**20}


def main() -> None:
    cluster = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
    second = None
    try:
        print(cluster.address, flush=True)
        for line in sys.stdin:
            if line == "add\n":
                second = cluster.add_node(**NODE)
                cluster.wait_for_nodes()
                print(second.node_id, flush=True)
            else:
                if second is not None:
                    cluster.remove_node(second, allow_graceful=False)
                second = None
                print("killed", flush=True)
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()

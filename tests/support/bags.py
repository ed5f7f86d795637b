"""Bags of ROS 2 with joint states, as a recorder writes them."""

__all__ = ["write_bag"]


def write_bag(folder, plugin, angle, speed, torque, *, stamped=True):
    """Write joint states, 2 ms apart, and other messages; `plugin` is "SQLITE3" or "MCAP"."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    of = store.types
    with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        words = writer.add_connection("/words", "std_msgs/msg/String", typestore=store)
        for k, (q, dq, tau) in enumerate(zip(angle, speed, torque, strict=True)):
            stamp = of["builtin_interfaces/msg/Time"](*divmod(2_000_000 * k + 5 * 10**9, 10**9) if stamped else (0, 0))
            header = of["std_msgs/msg/Header"](stamp, "base")
            message = of["sensor_msgs/msg/JointState"](header, ["shoulder", "elbow"], q, dq, tau)
            writer.write(states, 2_000_000 * k, store.serialize_cdr(message, message.__msgtype__))
            text = of["std_msgs/msg/String"]("hello")
            writer.write(words, 2_000_000 * k, store.serialize_cdr(text, text.__msgtype__))

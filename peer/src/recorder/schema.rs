//! The message definitions that readers need, in the text form of ROS 2 (`ros2msg`): the message
//! first, then every message in it after a line of equals signs and its name.

/// A message type by its full name.
pub struct Schema {
    pub name: &'static str,
    pub definition: &'static str,
}

macro_rules! dependency {
    ($name:literal, $definition:literal) => {
        concat!(
            "========================================",
            "========================================\n",
            "MSG: ",
            $name,
            "\n",
            $definition
        )
    };
}

macro_rules! header {
    () => {
        concat!(
            dependency!(
                "std_msgs/Header",
                "builtin_interfaces/Time stamp\nstring frame_id\n"
            ),
            dependency!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n")
        )
    };
}

pub const POSE: Schema = Schema {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: concat!(
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
        header!(),
        dependency!(
            "geometry_msgs/PoseWithCovariance",
            "geometry_msgs/Pose pose\nfloat64[36] covariance\n"
        ),
        dependency!(
            "geometry_msgs/Pose",
            "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
        ),
        dependency!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
        dependency!(
            "geometry_msgs/Quaternion",
            "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
        ),
    ),
};

pub const CLOUD: Schema = Schema {
    name: "sensor_msgs/msg/PointCloud2",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\n",
        "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\n",
        "uint32 row_step\nuint8[] data\nbool is_dense\n",
        header!(),
        dependency!(
            "sensor_msgs/PointField",
            "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n\
             uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\n\
             string name\nuint32 offset\nuint8 datatype\nuint32 count\n"
        ),
    ),
};

pub const TEXT: Schema = Schema {
    name: "std_msgs/msg/String",
    definition: "string data\n",
};

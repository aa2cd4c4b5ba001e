#pragma once
// Name, version and identifier of each kind of message.

#include "schemas/angle_generated.h"
#include "schemas/cloud_generated.h"
#include "schemas/command_generated.h"
#include "schemas/config_generated.h"
#include "schemas/config_revision_generated.h"
#include "schemas/features_generated.h"
#include "schemas/flow_ack_generated.h"
#include "schemas/gnss_generated.h"
#include "schemas/graph_poses_generated.h"
#include "schemas/host_time_generated.h"
#include "schemas/imu_generated.h"
#include "schemas/loop_generated.h"
#include "schemas/map_correction_generated.h"
#include "schemas/map_pose_generated.h"
#include "schemas/map_tile_generated.h"
#include "schemas/odometry_features_generated.h"
#include "schemas/odometry_generated.h"
#include "schemas/packets_generated.h"
#include "schemas/path_generated.h"
#include "schemas/preview_generated.h"
#include "schemas/progress_generated.h"
#include "schemas/rejected_generated.h"
#include "schemas/status_generated.h"
#include "schemas/submap_generated.h"
#include "schemas/sweep_generated.h"

namespace zloam {

/// kSchema: the schema's file name without .fbs; kIdentifier: its file_identifier; kMajor: changes
/// only with a new key.
template <class T>
struct Kind;

#define ZLOAM_KIND(Type, schema_name, identifier)          \
  template <>                                              \
  struct Kind<msg::Type> {                                 \
    static constexpr const char* kSchema = schema_name;    \
    static constexpr const char* kIdentifier = identifier; \
    static constexpr int kMajor = 1;                       \
  }
ZLOAM_KIND(Cloud, "cloud", "ZLCL");
ZLOAM_KIND(Command, "command", "ZLCM");
ZLOAM_KIND(CommandReply, "command", "ZLCM");
ZLOAM_KIND(EffectiveConfig, "config", "ZLCF");
ZLOAM_KIND(ConfigRevision, "config_revision", "ZLCR");
ZLOAM_KIND(Features, "features", "ZLFE");
ZLOAM_KIND(FlowAck, "flow_ack", "ZLAK");
ZLOAM_KIND(GnssBatch, "gnss", "ZLGN");
ZLOAM_KIND(GraphPoses, "graph_poses", "ZLGP");
ZLOAM_KIND(HostTime, "host_time", "ZLHT");
ZLOAM_KIND(ImuBatch, "imu", "ZLIM");
ZLOAM_KIND(Loop, "loop", "ZLLO");
ZLOAM_KIND(MapCorrection, "map_correction", "ZLMC");
ZLOAM_KIND(MapPose, "map_pose", "ZLMP");
ZLOAM_KIND(MapTile, "map_tile", "ZLTI");
ZLOAM_KIND(MotorAngles, "angle", "ZLAN");
ZLOAM_KIND(Odometry, "odometry", "ZLOD");
ZLOAM_KIND(OdometryFeatures, "odometry_features", "ZLOF");
ZLOAM_KIND(Packets, "packets", "ZLPK");
ZLOAM_KIND(Path, "path", "ZLPA");
ZLOAM_KIND(Preview, "preview", "ZLPV");
ZLOAM_KIND(Progress, "progress", "ZLPR");
ZLOAM_KIND(Rejected, "rejected", "ZLRJ");
ZLOAM_KIND(Status, "status", "ZLST");
ZLOAM_KIND(Submap, "submap", "ZLSM");
ZLOAM_KIND(Sweep, "sweep", "ZLSW");
#undef ZLOAM_KIND

}  // namespace zloam

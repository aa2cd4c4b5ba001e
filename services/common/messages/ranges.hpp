#pragma once
// Checks beyond the FlatBuffers verifier: whether the values of a well-formed message make sense.
// Each function returns a sentence, or an empty text. Used by verify() only.

#include <string>

#include "common/messages/kinds.hpp"

namespace zloam {

std::string range_error(const msg::Cloud& m);
std::string range_error(const msg::Command& m);
std::string range_error(const msg::CommandReply& m);
std::string range_error(const msg::EffectiveConfig& m);
std::string range_error(const msg::ConfigRevision& m);
std::string range_error(const msg::Features& m);
std::string range_error(const msg::FlowAck& m);
std::string range_error(const msg::GnssBatch& m);
std::string range_error(const msg::GraphPoses& m);
std::string range_error(const msg::HostTime& m);
std::string range_error(const msg::ImuBatch& m);
std::string range_error(const msg::MotorAngles& m);
std::string range_error(const msg::Loop& m);
std::string range_error(const msg::MapCorrection& m);
std::string range_error(const msg::MapPose& m);
std::string range_error(const msg::MapTile& m);
std::string range_error(const msg::Odometry& m);
std::string range_error(const msg::OdometryFeatures& m);
std::string range_error(const msg::Packets& m);
std::string range_error(const msg::Path& m);
std::string range_error(const msg::Preview& m);
std::string range_error(const msg::Progress& m);
std::string range_error(const msg::Rejected& m);
std::string range_error(const msg::Status& m);
std::string range_error(const msg::Submap& m);
std::string range_error(const msg::Sweep& m);

}  // namespace zloam

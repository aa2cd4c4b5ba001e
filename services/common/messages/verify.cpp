#include "common/messages/verify.hpp"

#include <flatbuffers/flatbuffers.h>

#include <string>

#include "common/messages/ranges.hpp"

namespace zloam {
namespace {

// Deep enough for every schema; far below what a hostile message would need to exhaust the stack.
constexpr flatbuffers::uoffset_t kMaxDepth = 16;
// Tables in one message: fixes, trace points and status lists; arrays of points are structs.
constexpr flatbuffers::uoffset_t kMaxTables = 100'000;

VerifyResult garbage(std::string reason) { return {VerifyStatus::kGarbage, std::move(reason)}; }

}  // namespace

template <class T>
VerifyResult verify(std::span<const std::uint8_t> bytes, std::string_view encoding) {
  static const std::string expected = encoding_of_schema(Kind<T>::kSchema, Kind<T>::kMajor);
  if (encoding != expected) {
    return garbage("encoding is '" + std::string(encoding.substr(0, 100)) + "' and not '" +
                   expected + "'");
  }
  // Root offset and identifier.
  if (bytes.size() < 8) return garbage("too short for a FlatBuffer");
  if (reinterpret_cast<std::uintptr_t>(bytes.data()) % kMessageAlignment != 0) {
    return garbage("the bytes are not aligned");
  }
  if (!flatbuffers::BufferHasIdentifier(bytes.data(), Kind<T>::kIdentifier)) {
    return garbage(std::string("file identifier is not ") + Kind<T>::kIdentifier);
  }
  flatbuffers::Verifier verifier(bytes.data(), bytes.size(), kMaxDepth, kMaxTables);
  if (!verifier.VerifyBuffer<T>(Kind<T>::kIdentifier)) {
    return garbage("the FlatBuffers verifier refused it");
  }
  std::string error = range_error(message_of<T>(bytes));
  if (!error.empty()) return {VerifyStatus::kInvalid, std::move(error)};
  return {};
}

template VerifyResult verify<msg::Cloud>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Command>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::CommandReply>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::EffectiveConfig>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::ConfigRevision>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Features>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::FlowAck>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::GnssBatch>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::GraphPoses>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::HostTime>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::ImuBatch>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Loop>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::MapCorrection>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::MapPose>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::MapTile>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::MotorAngles>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Odometry>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::OdometryFeatures>(std::span<const std::uint8_t>,
                                                    std::string_view);
template VerifyResult verify<msg::Packets>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Path>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Preview>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Progress>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Rejected>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Status>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Submap>(std::span<const std::uint8_t>, std::string_view);
template VerifyResult verify<msg::Sweep>(std::span<const std::uint8_t>, std::string_view);

}  // namespace zloam

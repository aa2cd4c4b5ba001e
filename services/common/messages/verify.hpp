#pragma once
// A received payload becomes a message only through here: Zenoh encoding, file identifier, the
// FlatBuffers verifier, then ranges. A failure has a reason, and the caller drops the payload.

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "common/messages/keys.hpp"
#include "common/messages/kinds.hpp"

namespace zloam {

/// kGarbage: not this kind of message at all; kInvalid: well-formed, but a value is out of range.
enum class VerifyStatus : std::uint8_t { kOk, kGarbage, kInvalid };

struct VerifyResult {
  VerifyStatus status = VerifyStatus::kOk;
  /// a sentence for the log; empty when ok
  std::string reason;
  bool ok() const { return status == VerifyStatus::kOk; }
};

/// Alignment that a payload needs before it is read (64-bit members).
inline constexpr std::size_t kMessageAlignment = 8;

/// All checks in order. The bytes must be aligned to kMessageAlignment.
/// Ranges: poses and covariances finite, quaternions within 1e-3 of unit length, covariance of 36
/// or no values, ring < rings, parallel vectors of equal length, feature and map points finite. The
/// points of a sweep may be NaN (a cell without a return): dropping those is registration's work.
template <class T>
VerifyResult verify(std::span<const std::uint8_t> bytes, std::string_view encoding);

/// The message; only for bytes that verify() found ok.
template <class T>
const T& message_of(std::span<const std::uint8_t> bytes) {
  return *flatbuffers::GetRoot<T>(bytes.data());
}

}  // namespace zloam

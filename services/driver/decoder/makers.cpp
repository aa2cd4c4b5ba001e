#include "driver/decoder/makers.hpp"

#include <algorithm>
#include <array>
#include <cctype>

#include "driver/ouster/ouster.hpp"
#include "driver/velodyne/velodyne.hpp"

namespace zloam::driver {
namespace {

struct Entry {
  std::vector<std::string> (*models)();
  std::unique_ptr<const Maker> (*make)(const DecodingOptions& options);
};

// The order decides nothing: no two makers' packets are alike.
constexpr std::array kMakers = {
    Entry{velodyne::models, velodyne::make},
    Entry{ouster::models, ouster::make},
};

std::string plain(std::string_view name) {
  std::string plain;
  for (const char c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      plain.push_back(static_cast<char>(std::tolower(static_cast<unsigned char>(c))));
    }
  }
  return plain;
}

}  // namespace

std::vector<std::string> known_models() {
  std::vector<std::string> all;
  for (const Entry& entry : kMakers) {
    for (std::string& model : entry.models()) all.push_back(std::move(model));
  }
  return all;
}

bool is_known_model(std::string_view name) {
  const std::vector<std::string> known = known_models();
  return std::any_of(known.begin(), known.end(),
                     [&](const std::string& model) { return plain(model) == plain(name); });
}

Makers::Makers(const DecodingOptions& options) {
  for (const Entry& entry : kMakers) makers_.push_back(entry.make(options));
}

PacketKind Makers::kind(std::span<const std::uint8_t> payload) const {
  if (settled_ != nullptr) return settled_->kind(payload);
  for (const auto& maker : makers_) {
    if (const PacketKind kind = maker->kind(payload); kind != PacketKind::kForeign) return kind;
  }
  return PacketKind::kForeign;
}

void Makers::settle(std::span<const std::uint8_t> data_packet) {
  if (settled_ != nullptr) return;
  for (const auto& maker : makers_) {
    if (maker->kind(data_packet) != PacketKind::kData) continue;
    settled_ = maker.get();
    return;
  }
}

const Maker& Makers::maker() const {
  if (settled_ != nullptr) return *settled_;
  for (const auto& maker : makers_) {
    if (maker->described()) return *maker;
  }
  return *makers_.front();
}

std::string Makers::metadata_error() const {
  std::string error;
  for (const auto& maker : makers_) {
    if (maker->described()) return {};
    error = maker->metadata_error();
  }
  return error;
}

}  // namespace zloam::driver

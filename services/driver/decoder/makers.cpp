#include "driver/decoder/makers.hpp"

#include <algorithm>
#include <array>

#include "driver/decoder/label.hpp"
#include "driver/hesai/hesai.hpp"
#include "driver/ouster/ouster.hpp"
#include "driver/velodyne/velodyne.hpp"

namespace zloam::driver {
namespace {

struct Entry {
  std::vector<std::string> (*models)();
  std::unique_ptr<const Maker> (*make)(const DecodingOptions& options);
};

// The order does not matter: no packet fits two makers.
constexpr std::array kMakers = {
    Entry{velodyne::models, velodyne::make},
    Entry{ouster::models, ouster::make},
    Entry{hesai::models, hesai::make},
};

bool names(const std::vector<std::string>& models, std::string_view name) {
  return std::any_of(models.begin(), models.end(), [&](const std::string& model) {
    return plain_label(model) == plain_label(name);
  });
}

}  // namespace

std::vector<std::string> known_models() {
  std::vector<std::string> all;
  for (const Entry& entry : kMakers) {
    for (std::string& model : entry.models()) all.push_back(std::move(model));
  }
  return all;
}

bool is_known_model(std::string_view name) { return names(known_models(), name); }

Makers::Makers(const DecodingOptions& options) {
  for (const Entry& entry : kMakers) {
    makers_.push_back(entry.make(options));
    if (names(entry.models(), options.model)) named_ = makers_.back().get();
  }
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
  if (named_ != nullptr) return *named_;
  for (const auto& maker : makers_) {
    if (maker->described()) return *maker;
  }
  return *makers_.front();
}

std::string Makers::metadata_error() const {
  std::string kinds;
  for (const auto& maker : makers_) {
    if (maker->described()) return {};
    if (std::string error = maker->metadata_error(); !error.empty()) return error;
    const std::string kind = maker->metadata_kind();
    if (!kind.empty()) kinds += (kinds.empty() ? "" : ", ") + kind;
  }
  return "it is none of what can be read: " + kinds;
}

}  // namespace zloam::driver

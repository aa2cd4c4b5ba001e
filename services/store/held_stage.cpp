// Messages whose publisher is not known yet: they are held until it confirms its run, or refused.

#include <utility>

#include "store/store_stage.hpp"

namespace zloam::store {
namespace {

// Limits of messages that are held until their publisher confirms them; a publisher that is present
// does so at once.
constexpr std::size_t kUnconfirmedMessages = 512;
constexpr std::size_t kUnconfirmed_bytes = std::size_t{32} << 20;
constexpr std::int64_t kUnconfirmed_ns = 2'000'000'000;
constexpr std::chrono::milliseconds kAnswersWithin{1000};

Source source_of(const msg::Header& header) {
  return {header.run(), header.map_id(), header.term(), header.instance()->str()};
}

}  // namespace

runtime::Outcome StoreStage::take_or_hold(const TileMessage& tile) {
  if (!publisher_.believes(source_of(tile.header()))) return hold(tiles_, tile.raw());
  take(tile);
  return runtime::Outcome::kProcessed;
}

runtime::Outcome StoreStage::take_or_hold(const PoseMessage& pose) {
  if (!publisher_.believes(source_of(pose.header()), pose->instant_ns())) {
    return hold(poses_, pose.raw());
  }
  take(pose);
  return runtime::Outcome::kProcessed;
}

runtime::Outcome StoreStage::take_or_hold(const SubmapMessage& submap) {
  if (!publisher_.believes(source_of(submap.header()))) return hold(submaps_, submap.raw());
  take(submap);
  return runtime::Outcome::kProcessed;
}

runtime::Outcome StoreStage::hold(runtime::Inlet* inlet, const runtime::Message& message) {
  held_.push_back({inlet, message, runtime::steady_ns()});
  held_bytes_ += message.bytes.size();
  while (held_.size() > kUnconfirmedMessages || held_bytes_ > kUnconfirmed_bytes) refuse_oldest();
  return runtime::Outcome::kHeld;
}

StoreStage::Held StoreStage::take_oldest() {
  Held oldest = std::move(held_.front());
  held_.pop_front();
  held_bytes_ -= oldest.message.bytes.size();
  return oldest;
}

void StoreStage::refuse_oldest() {
  Held oldest = take_oldest();
  ++unconfirmed_;
  oldest.inlet->settle(std::move(oldest.message),
                       [](const runtime::Message&) { return runtime::Outcome::kFenced; });
}

void StoreStage::ask_publisher() {
  if (held_.empty() || question_.started()) return;
  const std::string run = std::to_string(held_.back().message.header->run());
  question_.start(stage_.session(),
                  stage_.keys().of(Key::kMapOdometry) + "?run=" + run + ";sweep=0.." +
                      std::to_string(std::uint64_t{1} << 62),
                  kAnswersWithin, question_bell_);
}

void StoreStage::hear_publisher() {
  const auto answers = question_.take();
  if (!answers) return;
  for (const zenoh::Sample& sample : *answers) {
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
    if (!verify<msg::MapPose>(bytes.data(), sample.encoding).ok()) continue;
    const auto& pose = message_of<msg::MapPose>(bytes.data());
    const Source source = source_of(*pose.header());
    is_new_ |= !publisher_.believes(source);
    publisher_.answered(source, pose.instant_ns());
  }
}

/// Stores the held messages whose publisher has been confirmed, in their order, and refuses those
/// that nobody confirmed within kUnconfirmed_ns.
void StoreStage::settle_held() {
  for (std::size_t left = held_.size(); left > 0; --left) {
    Held held = take_oldest();
    if (is_believed(held)) {
      held.inlet->settle(std::move(held.message), [&](const runtime::Message& m) {
        if (held.inlet == tiles_) {
          take(TileMessage(m));
        } else if (held.inlet == submaps_) {
          take(SubmapMessage(m));
        } else {
          take(PoseMessage(m));
        }
        return runtime::Outcome::kProcessed;
      });
      continue;
    }
    held_bytes_ += held.message.bytes.size();
    held_.push_back(std::move(held));
  }
  const std::int64_t before_ns = runtime::steady_ns() - kUnconfirmed_ns;
  while (!held_.empty() && held_.front().since_ns < before_ns) refuse_oldest();
}

bool StoreStage::is_believed(const Held& held) const {
  const Source source = source_of(*held.message.header);
  if (held.inlet != poses_) return publisher_.believes(source);
  return publisher_.believes(source, message_of<msg::MapPose>(held.message.bytes).instant_ns());
}

}  // namespace zloam::store

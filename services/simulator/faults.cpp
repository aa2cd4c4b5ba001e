#include "simulator/faults.hpp"

#include <stdexcept>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

constexpr std::size_t kStampOffset = 1200;
constexpr std::size_t kPositionStampOffset = 198;
constexpr std::int64_t kHourUs = 3'600'000'000;

void shift_stamp(Datagram& datagram, double step_s) {
  const std::size_t offset = datagram.is_data() ? kStampOffset : kPositionStampOffset;
  std::int64_t stamp = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    stamp |= static_cast<std::int64_t>(datagram.payload[offset + i]) << (8 * i);
  }
  stamp = (stamp + static_cast<std::int64_t>(step_s * 1e6)) % kHourUs;
  stamp = stamp < 0 ? stamp + kHourUs : stamp;
  for (std::size_t i = 0; i < 4; ++i) {
    datagram.payload[offset + i] = static_cast<std::uint8_t>(stamp >> (8 * i));
  }
}

}  // namespace

FaultInjector::FaultInjector(const FaultConfig& config, std::int64_t start_ns)
    : config_(config), start_ns_(start_ns) {
  for (const double part :
       {config.loss, config.duplication, config.delay, config.corruption, config.wrong_length}) {
    if (!(part >= 0.0 && part <= 1.0)) {
      throw std::invalid_argument("parts of packets must be from 0 to 1");
    }
  }
  if (config.delay_packets < 1) {
    throw std::invalid_argument("delay_packets must be at least 1");
  }
}

// Faults that belong to an instant; false if nothing arrives at it.
bool FaultInjector::disturb_time(Datagram& datagram) {
  const double time_s = static_cast<double>(datagram.sent_ns - start_ns_) * 1e-9;
  if (config_.clock_step_s != 0.0 && time_s >= config_.clock_step_at_s) {
    if (!stepped_) {
      log_.push_back({datagram.index, "clock_step"});
      stepped_ = true;
    }
    shift_stamp(datagram, config_.clock_step_s);
  }
  if (config_.gap_s > 0.0 && time_s >= config_.gap_start_s &&
      time_s < config_.gap_start_s + config_.gap_s) {
    if (datagram.is_data()) {
      log_.push_back({datagram.index, "gap"});
    }
    return false;
  }
  return true;
}

void FaultInjector::release(std::int64_t now_ns, std::vector<Datagram>& out) {
  std::vector<Held> still;
  for (Held& held : held_) {
    if (--held.remaining > 0) {
      still.push_back(std::move(held));
    } else {
      held.datagram.sent_ns = now_ns;
      out.push_back(std::move(held.datagram));
    }
  }
  held_ = std::move(still);
}

void FaultInjector::pass_one(Datagram datagram, std::vector<Datagram>& out) {
  if (!disturb_time(datagram)) {
    return;
  }
  if (!datagram.is_data()) {
    out.push_back(std::move(datagram));
    return;
  }
  Random random(config_.seed, Stream::kFaults, static_cast<std::uint64_t>(datagram.index));
  const bool lost = random.chance(config_.loss);
  const bool twice = random.chance(config_.duplication);
  const bool late = random.chance(config_.delay);
  const bool corrupted = random.chance(config_.corruption);
  const bool cut = random.chance(config_.wrong_length);
  const std::int64_t now_ns = datagram.sent_ns;
  const auto note = [&](const char* kind) { log_.push_back({datagram.index, kind}); };
  if (lost) {
    note("lost");
    return;
  }
  if (corrupted) {
    note("corrupted");
    for (int i = 0; i < 8; ++i) {
      datagram.payload[random.bits() % datagram.payload.size()] ^=
          static_cast<std::uint8_t>(1 + random.bits() % 255);
    }
  }
  if (cut) {
    note("cut");
    datagram.payload.resize(random.bits() % datagram.payload.size());
  }
  if (late) {
    note("late");
    release(now_ns, out);
    held_.push_back({std::move(datagram), config_.delay_packets});
    return;
  }
  if (twice) {
    note("duplicated");
    out.push_back(datagram);
  }
  out.push_back(std::move(datagram));
  release(now_ns, out);
}

std::vector<Datagram> FaultInjector::pass(std::vector<Datagram> in) {
  std::vector<Datagram> out;
  for (Datagram& datagram : in) {
    pass_one(std::move(datagram), out);
  }
  return out;
}

std::vector<Datagram> FaultInjector::flush() {
  std::vector<Datagram> out;
  for (Held& held : held_) {
    out.push_back(std::move(held.datagram));
  }
  held_.clear();
  return out;
}

}  // namespace zloam::simulator

#include "store/live_publisher.hpp"

#include <algorithm>
#include <limits>

namespace zloam::store {
namespace {

// Maximum distance in time of a credible pose from the publisher's other poses. After a longer
// silence of the sensor the publisher is asked once more.
constexpr std::int64_t kNear_ns = 10'000'000'000;

std::int64_t later(std::int64_t ns) {
  return ns > std::numeric_limits<std::int64_t>::max() - kNear_ns ? ns : ns + kNear_ns;
}

std::int64_t sooner(std::int64_t ns) {
  return ns < std::numeric_limits<std::int64_t>::min() + kNear_ns ? ns : ns - kNear_ns;
}

}  // namespace

void LivePublisher::answered(const Source& source, std::int64_t instant_ns) {
  if (source_ != source) {
    source_ = source;
    first_ns_ = last_ns_ = instant_ns;
    return;
  }
  first_ns_ = std::min(first_ns_, instant_ns);
  last_ns_ = std::max(last_ns_, instant_ns);
}

bool LivePublisher::believes(const Source& source, std::int64_t instant_ns) const {
  return believes(source) && instant_ns >= sooner(first_ns_) && instant_ns <= later(last_ns_);
}

void LivePublisher::stored(std::int64_t instant_ns) { last_ns_ = std::max(last_ns_, instant_ns); }

bool LivePublisher::is_beyond(std::int64_t instant_ns) const {
  return source_ && instant_ns > later(last_ns_);
}

}  // namespace zloam::store

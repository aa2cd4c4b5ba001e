#include "common/runtime/singleton.hpp"

#include <algorithm>
#include <chrono>
#include <limits>
#include <utility>

#include "common/runtime/whole_number.hpp"

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kTimeout{500};
// Maximum of other instances remembered, so that a flood of tokens can't fill the memory.
constexpr std::size_t kMostOthers = 64;

}  // namespace

std::optional<Seniority> seniority_of(const std::string& key) {
  constexpr std::string_view kActive = "/active/";
  const std::size_t active = key.rfind(kActive);
  if (active == std::string::npos || active == 0) return std::nullopt;
  const std::size_t begin = key.rfind('/', active - 1) + 1;
  const std::string_view numbers = std::string_view(key).substr(active + kActive.size());
  const std::size_t slash = numbers.find('/');
  if (slash == std::string_view::npos) return std::nullopt;
  const auto term = whole_number<std::uint32_t>(numbers.substr(0, slash));
  const auto since_ns = whole_number<std::int64_t>(numbers.substr(slash + 1));
  if (!term || !since_ns) return std::nullopt;
  return Seniority{*term, *since_ns, key.substr(begin, active - begin)};
}

Singleton::Singleton(zenoh::Session& session, const Keys& keys, const std::string& stage,
                     Seniority own, std::shared_ptr<std::atomic<bool>> muted)
    : session_(session),
      keys_(keys),
      stage_(stage),
      all_(keys.active(stage, "*", "*", "*")),
      muted_(std::move(muted)),
      term_(own.term),
      own_(std::move(own)) {
  subscriber_ = session_.declare_liveliness_subscriber(all_, [this](zenoh::Sample&& sample) {
    hear(sample.key, sample.kind == zenoh::SampleKind::kPut);
  });
}

void Singleton::enter() {
  {
    const std::lock_guard lock(mutex_);
    if (has_entered_) return;
    has_entered_ = true;
  }
  declare(own_.term);
}

// Declares the new token before the old one is dropped, so that there is always a token.
void Singleton::declare(std::uint32_t term) {
  zenoh::LivelinessToken token = session_.declare_liveliness_token(
      keys_.active(stage_, own_.instance, std::to_string(term), std::to_string(own_.since_ns)));
  token_ = std::move(token);
}

void Singleton::ask() {
  for (const std::string& key : session_.liveliness_get(all_, kTimeout)) hear(key, true);
}

void Singleton::hear(const std::string& key, bool there) {
  const auto other = seniority_of(key);
  if (!other) return;
  const std::lock_guard lock(mutex_);
  // Ignore this instance's own tokens, of the present term or a lesser one.
  if (other->instance == own_.instance && other->since_ns == own_.since_ns) return;
  if (!there) {
    others_.erase(*other);
    passed_.erase(*other);
  } else if (others_.size() < kMostOthers &&
             is_plausible_term(other->term, std::max(own_.term, greatest_))) {
    others_.insert(*other);
    greatest_ = std::max(greatest_, other->term);
    constexpr std::int64_t kLast_ns = std::numeric_limits<std::int64_t>::max() - 1;
    if (!has_entered_) {
      own_.since_ns = std::max(own_.since_ns, std::min(other->since_ns, kLast_ns) + 1);
    }
  }
  *muted_ = held_ || elder_locked();
}

void Singleton::take_over() {
  std::uint32_t term = 0;
  {
    const std::lock_guard lock(mutex_);
    term = std::max(own_.term, greatest_);
    for (const Seniority& other : others_) {
      if (other < own_) passed_.insert(other);
    }
    if (term < std::numeric_limits<std::uint32_t>::max()) ++term;
  }
  at_least(term);
}

void Singleton::at_least(std::uint32_t term) {
  {
    const std::lock_guard lock(mutex_);
    if (term < own_.term) return;
    own_.term = term;
    term_ = term;
    *muted_ = held_ || elder_locked();
  }
  declare(term);
}

void Singleton::hold(bool silent) {
  const std::lock_guard lock(mutex_);
  held_ = silent;
  *muted_ = held_ || elder_locked();
}

std::optional<Seniority> Singleton::elder_locked() const {
  for (const Seniority& other : others_) {
    if (!(other < own_)) return std::nullopt;
    if (!passed_.contains(other)) return other;
  }
  return std::nullopt;
}

std::optional<Seniority> Singleton::elder() const {
  const std::lock_guard lock(mutex_);
  return elder_locked();
}

bool Singleton::overtaken() const {
  const auto other = elder();
  return other && other->term > term_.load();
}

bool Singleton::has_passed() const {
  const std::lock_guard lock(mutex_);
  return !passed_.empty();
}

std::vector<std::string> Singleton::juniors() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names;
  for (const Seniority& other : others_) {
    if (own_ < other) names.push_back(other.instance);
  }
  return names;
}

std::string Singleton::others() const {
  const std::lock_guard lock(mutex_);
  if (others_.empty()) return {};
  std::string names;
  for (const Seniority& other : others_) {
    names += (names.empty() ? "" : ", ") + other.instance;
  }
  return "there is a second " + stage_ + " in this robot (" + names + "): " +
         (elder_locked()
              ? "this one came later and is silent until the other has gone"
              : "it came later and is silent; end one of them, or give one robot another name");
}

}  // namespace zloam::runtime

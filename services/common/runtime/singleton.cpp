#include "common/runtime/singleton.hpp"

#include <charconv>
#include <chrono>

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kTimeout{500};
// More are a flood of somebody's.
constexpr std::size_t kMostOthers = 64;

}  // namespace

std::optional<Seniority> seniority_of(const std::string& key) {
  constexpr std::string_view kActive = "/active/";
  const std::size_t active = key.rfind(kActive);
  if (active == std::string::npos || active == 0) return std::nullopt;
  const std::size_t begin = key.rfind('/', active - 1) + 1;
  std::int64_t since_ns = 0;
  const char* end = key.data() + key.size();
  const auto [rest, error] = std::from_chars(key.data() + active + kActive.size(), end, since_ns);
  if (error != std::errc{} || rest != end) return std::nullopt;
  return Seniority{since_ns, key.substr(begin, active - begin)};
}

Singleton::Singleton(zenoh::Session& session, const Keys& keys, const std::string& stage,
                     Seniority own, std::shared_ptr<std::atomic<bool>> muted)
    : session_(session),
      stage_(stage),
      all_(keys.active(stage, "*", "*")),
      own_(std::move(own)),
      muted_(std::move(muted)) {
  subscriber_ = session_.declare_liveliness_subscriber(all_, [this](zenoh::Sample&& sample) {
    hear(sample.key, sample.kind == zenoh::SampleKind::kPut);
  });
  token_ = session_.declare_liveliness_token(
      keys.active(stage, own_.second, std::to_string(own_.first)));
}

void Singleton::ask() {
  for (const std::string& key : session_.liveliness_get(all_, kTimeout)) hear(key, true);
}

void Singleton::hear(const std::string& key, bool there) {
  const auto other = seniority_of(key);
  if (!other || *other == own_) return;
  const std::lock_guard lock(mutex_);
  if (!there) {
    others_.erase(*other);
  } else if (others_.size() < kMostOthers) {
    others_.insert(*other);
  }
  *muted_ = !others_.empty() && *others_.begin() < own_;
}

std::string Singleton::others() const {
  const std::lock_guard lock(mutex_);
  if (others_.empty()) return {};
  const bool younger = *others_.begin() < own_;
  std::string names;
  for (const auto& [since_ns, instance] : others_) {
    names += (names.empty() ? "" : ", ") + instance;
  }
  return "there is a second " + stage_ + " in this robot (" + names + "): " +
         (younger ? "this one came later and is silent until the other has gone"
                  : "it came later and is silent; end one of them, or give one robot another name");
}

}  // namespace zloam::runtime

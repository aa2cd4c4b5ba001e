#include "registration/io/colleagues.hpp"

#include <cstdlib>
#include <sstream>
#include <utility>

#include "common/runtime/read.hpp"
#include "schemas/progress_generated.h"
#include "schemas/status_generated.h"

namespace zloam::registration {
namespace {

std::optional<std::vector<std::string>> wrong_members() {
  const char* text = std::getenv("ZLOAM_FAULT_MEMBERS");
  if (text == nullptr) return std::nullopt;
  runtime::log_warning("FAULT INJECTION: the list of the replicas is wrong on purpose",
                       {{"members", text}});
  std::vector<std::string> members;
  std::istringstream list{std::string(text)};
  for (std::string name; std::getline(list, name, ',');) members.push_back(name);
  return members;
}

constexpr std::size_t kMostNames = 64;

/// loam/<robot>/service/registration/<instance>/alive
std::string instance_of(const std::string& key) {
  const std::size_t end = key.rfind('/');
  const std::size_t begin = key.rfind('/', end - 1) + 1;
  return key.substr(begin, end - begin);
}

bool fit(msg::ServiceHealth health) {
  return health == msg::ServiceHealth::Ready || health == msg::ServiceHealth::Degraded;
}

}  // namespace

Colleagues::Colleagues(runtime::Stage& stage, std::function<void()> on_change)
    : on_change_(std::move(on_change)), wrong_(wrong_members()) {
  const Keys& keys = stage.keys();
  const std::string& name = stage.identity().stage;
  zenoh::Session& session = stage.session();
  subscribers_.push_back(session.declare_liveliness_subscriber(
      keys.alive(name, "*"), [this](zenoh::Sample&& sample) { on_token(sample); }));
  subscribers_.push_back(session.declare_subscriber(
      keys.status(name, "*"), [this](zenoh::Sample&& sample) { on_status(sample); }));
  subscribers_.push_back(session.declare_subscriber(
      keys.of(Key::kProgress), [this](zenoh::Sample&& sample) { on_progress(sample); }));
}

std::vector<std::string> Colleagues::members() const {
  if (wrong_) return *wrong_;
  const std::lock_guard lock(mutex_);
  std::vector<std::string> members;
  for (const std::string& instance : alive_) {
    const auto ready = ready_.find(instance);
    if (ready != ready_.end() && ready->second) members.push_back(instance);
  }
  return members;
}

std::optional<Progress> Colleagues::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

void Colleagues::on_token(const zenoh::Sample& sample) {
  const std::string instance = instance_of(sample.key);
  {
    const std::lock_guard lock(mutex_);
    if (sample.kind == zenoh::SampleKind::kPut) {
      alive_.insert(instance);
    } else {
      alive_.erase(instance);
      ready_.erase(instance);
    }
  }
  on_change_();
}

void Colleagues::on_status(const zenoh::Sample& sample) {
  const runtime::Read<msg::Status> status(Key::kStatus, sample);
  if (!status) return;
  const std::string instance = status->instance()->str();
  {
    const std::lock_guard lock(mutex_);
    // A status may arrive before its instance's token. Names without a token are dropped if there
    // are too many of them.
    if (ready_.size() >= kMostNames && !ready_.contains(instance)) {
      std::erase_if(ready_, [this](const auto& r) { return !alive_.contains(r.first); });
    }
    bool& ready = ready_[instance];
    if (ready == fit(status->health())) return;
    ready = !ready;
  }
  on_change_();
}

void Colleagues::on_progress(const zenoh::Sample& sample) {
  const runtime::Read<msg::Progress> said(Key::kProgress, sample);
  if (!said) return;
  Progress progress{said->run(), said->next_sweep(), said->received_below(), {}};
  if (said->missing() != nullptr) {
    progress.missing.assign(said->missing()->begin(), said->missing()->end());
  }
  {
    const std::lock_guard lock(mutex_);
    progress_ = std::move(progress);
  }
  on_change_();
}

}  // namespace zloam::registration

#include "common/runtime/run_gate.hpp"

namespace zloam::runtime {
namespace {

// Maximum of drivers' tokens remembered, so that a flood of tokens can't fill the memory.
constexpr std::size_t kMostTokens = 64;

}  // namespace

void RunGate::token(const std::string& key, std::uint64_t run, bool there) {
  const std::lock_guard lock(mutex_);
  if (!there) {
    tokens_.erase({run, key});
  } else if (tokens_.size() < kMostTokens) {
    tokens_.emplace(run, key);
    if (followed_ && followed_->run == run) followed_->had_token = true;
  }
}

bool RunGate::has_token(std::uint64_t run) const {
  const auto first = tokens_.lower_bound({run, {}});
  return first != tokens_.end() && first->first == run;
}

bool RunGate::may_follow(std::uint64_t run, bool silent) const {
  if (!tokens_.empty() && !has_token(run)) return false;
  if (!followed_) return true;
  if (followed_->run == run) return silent;
  return tokens_.empty() ? silent : !has_token(followed_->run);
}

bool RunGate::is_silent(std::int64_t now_ns) const {
  if (!followed_) return false;
  const bool gone = followed_->had_token && !has_token(followed_->run);
  return now_ns - followed_->heard_ns >= (gone ? kGoneSilence_ns : kRunSilence_ns);
}

bool RunGate::admit(std::uint64_t run, bool replay, std::int64_t now_ns) {
  const std::lock_guard lock(mutex_);
  if (followed_ && followed_->run == run && followed_->replay == replay) {
    followed_->heard_ns = now_ns;
    return true;
  }
  if (!may_follow(run, is_silent(now_ns))) return false;
  followed_ = {run, replay, now_ns, has_token(run)};
  return true;
}

bool RunGate::follows(std::uint64_t run) const {
  const std::lock_guard lock(mutex_);
  return followed_ && followed_->run == run;
}

}  // namespace zloam::runtime

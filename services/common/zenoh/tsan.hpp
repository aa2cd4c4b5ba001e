#pragma once
// Informs ThreadSanitizer of what it can't see inside the Rust library, which is not instrumented:
// Zenoh hands an object over from one thread to another. No code in other builds.

#if defined(__SANITIZE_THREAD__)
extern "C" void __tsan_acquire(void* address);
extern "C" void __tsan_release(void* address);
#endif

namespace zloam::zenoh::detail {

#if defined(__SANITIZE_THREAD__)
inline constexpr bool kThreadSanitizer = true;
inline void hand_over(const void* object) { __tsan_release(const_cast<void*>(object)); }
inline void take_over(const void* object) { __tsan_acquire(const_cast<void*>(object)); }
#else
inline constexpr bool kThreadSanitizer = false;
inline void hand_over(const void*) {}
inline void take_over(const void*) {}
#endif

}  // namespace zloam::zenoh::detail
